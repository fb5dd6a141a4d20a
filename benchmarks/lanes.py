"""Measure lanes, lane changes, motion states and their cost, with the tracker in the loop.

    python benchmarks/lanes.py [SCENE_DIR...] [--simulate NAME:SEED[:SECONDS]]... [--trajectories CSV]...
        [--json OUT.json]

SCENE_DIR is a scene with truth; NAME is a scenario of `wayside simulate`, made for the occasion; CSV holds
real trajectories with lanes beside them (NAME.lanes.json), at which the simulated radar looks. Times are CPU
time of the traffic stages alone, without the first second.
"""

from __future__ import annotations

import argparse
import csv
import dataclasses
import gzip
import json
import math
import platform
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np

from service import __version__
from service.evaluation.counted import count
from service.evaluation.kinematics import Matches, match
from service.evaluation.lanes import score_changes, score_lanes
from service.evaluation.recorded import FoundChange, FoundLane, RecordedTracks, record
from service.evaluation.rules import RULES
from service.evaluation.truth import Scene, TruthChange, read_scene
from service.formats.json_frames import read_frames
from service.formats.length_class import length_class
from service.formats.sensor import SensorConfig
from service.simulation.scenario import from_trajectories
from service.simulation.scene_files import write_scene
from service.simulation.trajectories import read_trajectories
from service.tracking import tracker
from service.tracking.model import Frame, MotionState, TrackEstimates
from service.traffic import closing, monitor
from service.traffic.curves import beside
from service.traffic.model import Lane, LaneChange, LaneMap, Moment
from service.traffic.parameters import traffic_setup

STANDING_MPS = 0.3
STANDS = (MotionState.STATIONARY, MotionState.START_STOP)
SETTLED_S = 6.0  # a manoeuvre whose ends the truth had to cut off here is no complete change of lanes
SIGHT_M = (25.0, 140.0)
MAST_M = 30.0  # before the first vehicle of real trajectories
USED_BY = 5  # vehicles in sight, for a true lane to count
ONE_LANE_M = 1.75  # from the middle of a lane to a vehicle in it
NEAR_M = 1.2  # of a true lane to the learned one that is taken for it
AWAY_S = 3.0  # from a true change of lanes: the lane of a vehicle is beyond doubt
CLASSED_FRAMES = 20  # that a vehicle was followed for, before its length class is judged
Labels = dict[tuple[int, int], tuple[str, str]]


@dataclass
class Run:
    """What the fold's two steps gave for a recording."""

    map: LaneMap
    live: LaneMap
    changes: list[LaneChange] = field(default_factory=list)
    scans: list[tuple[int, int, TrackEstimates]] = field(default_factory=list)  # frame, time, tracks
    maps: list[LaneMap] = field(default_factory=list)  # in force at each of them
    ms: list[float] = field(default_factory=list)


def run(frames: Iterable[Frame], config: SensorConfig) -> Run:
    parameters, setup = config.tracker_parameters(), traffic_setup(config)
    state, traffic = tracker.initial_state(parameters), monitor.initial_state()
    found = Run(traffic.map, traffic.map)
    for number, frame in enumerate(frames):
        state, estimates, _ = tracker.step(state, frame, parameters)
        moment = Moment(frame.time_us, frame.sequence if frame.sequence is not None else number, tick=False)
        begun = time.process_time()
        traffic, estimates, out = monitor.step(traffic, moment, estimates, setup)
        found.ms.append(1e3 * (time.process_time() - begun))
        found.changes += out.changes
        found.scans.append((moment.frame, frame.time_us, estimates))
        found.maps.append(traffic.map)
    time_us = moment.time_us
    for _ in range(10):  # until every track has ended
        time_us += 1_000_000
        state, estimates, _ = tracker.coast(state, time_us, parameters)
        traffic, _, out = monitor.step(traffic, Moment(time_us, moment.frame, tick=True), estimates, setup)
        found.changes += out.changes
    found.live, found.map = traffic.map, closing.whole_map(traffic, setup)
    found.changes += closing.told_by(found.map, traffic, time_us, setup).changes
    return found


def tracks_of(found: Run, scene: Scene) -> RecordedTracks:
    """The tracks as the scores read them."""
    by_frame = {frame: now for frame, _, now in found.scans}
    frames = []
    for number in scene.number.tolist():
        now = by_frame.get(number)
        columns = () if now is None else (now.number, now.x_m, now.y_m, now.vx_mps, now.vy_mps)
        rows = zip(*(column.tolist() for column in columns), strict=True)
        frames.append({str(row[0]): tuple(row[1:]) for row in rows})
    return record(frames)


def measure(directory: Path) -> dict[str, object]:
    config = SensorConfig.model_validate_json((directory / "site.json").read_bytes())
    scene = read_scene(directory)
    found = run(read_frames([directory / "frames.jsonl.gz"], config), config)
    tracks = tracks_of(found, scene)
    matches = match(count(scene, tracks, RULES), tracks, RULES)
    lanes = [FoundLane(lane.lane_id, lane.points_m) for lane in found.map.lanes if lane.kind == "lane"]
    scores, _ = score_lanes(scene, lanes, RULES)
    live = [FoundLane(lane.lane_id, lane.points_m) for lane in found.live.lanes if lane.kind == "lane"]
    origin_s = scene.origin_s
    changes = [FoundChange(c.time_us / 1e6 - origin_s, str(c.number)) for c in found.changes]
    scores |= score_changes(scene, changes, tracks, matches, RULES)
    scores |= complete_changes(scene, changes, tracks, matches)
    scores |= standing(scene, found, tracks, matches)
    true = read_labels(directory / "truth.csv.gz")
    scores |= lane_right(scene, found, tracks, matches, true)
    scores |= {"classes": length_classes(scene, found, tracks, matches, true)}
    return {
        "scene": scene.name,
        **scores,
        "live_lanes_right": score_lanes(scene, live, RULES)[0]["lanes_right"],
        "turns": sum(lane.kind == "turn" for lane in found.map.lanes),
        **cost(found),
    }


def cost(found: Run) -> dict[str, float]:
    ms = np.array(found.ms[20:])
    tracks = float(np.mean([len(now) for _, _, now in found.scans]))
    return {
        "ms_mean": round(float(ms.mean()), 3), "ms_median": round(float(np.median(ms)), 3),
        "ms_p99": round(float(np.quantile(ms, 0.99)), 3), "ms_max": round(float(ms.max()), 2),
        "tracks_mean": round(tracks, 1),
    }  # fmt: skip


def complete_changes(
    scene: Scene, changes: list[FoundChange], tracks: RecordedTracks, matches: Matches
) -> dict[str, float | int]:
    """Recall of the manoeuvres that went all the way from one middle to the other, in sight of the radar."""
    since = scene.time_s - scene.origin_s

    def whole(change: TruthChange) -> bool:
        rows = scene.rows
        first, last = rows.start[np.argmin(np.abs(since - change.t_s)) + np.arange(2)]
        here = first + np.flatnonzero(rows.vehicle[first:last] == change.vehicle)
        sight = len(here) and SIGHT_M[0] < math.hypot(rows.x_m[here[0]], rows.y_m[here[0]]) < SIGHT_M[1]
        return bool(sight) and max(change.t_s - change.start_s, change.end_s - change.t_s) < SETTLED_S - 0.1

    chosen = tuple(change for change in scene.changes if whole(change))
    scores = score_changes(dataclasses.replace(scene, changes=chosen), changes, tracks, matches, RULES)
    return {"complete_true": len(chosen), "complete_recall": scores["changes_recall"]}


def standing(scene: Scene, found: Run, tracks: RecordedTracks, matches: Matches) -> dict[str, float | int]:
    """The share of the time of standing vehicles, as far as tracked, in which they are taken for that."""
    motion = {(frame, str(n)): m for frame, _, now in found.scans
              for n, m in zip(now.number.tolist(), now.motion.tolist(), strict=True)}  # fmt: skip
    speed = np.hypot(scene.rows.vx_mps[matches.row], scene.rows.vy_mps[matches.row])
    still = np.flatnonzero(speed < STANDING_MPS)
    judged = [
        motion[int(scene.number[matches.frame[k]]), tracks.ids[tracks.track[matches.state[k]]]] in STANDS
        for k in still
    ]
    return {"standing_states": len(judged), "standing_right": float(np.mean(judged)) if judged else math.nan}


def read_labels(path: Path) -> dict[tuple[int, int], tuple[str, str]]:
    """Return lane and class of each vehicle in each frame of a scene."""
    with gzip.open(path, "rt", newline="") as file:
        return {(int(r["frame"]), int(r["id"])): (r["lane"], r["class"]) for r in csv.DictReader(file)}


def lane_right(
    scene: Scene, found: Run, tracks: RecordedTracks, matches: Matches, true: Labels
) -> dict[str, float | int]:
    """The share of states in the right lane, of those in a lane, away from the vehicle's true changes.

    The lane that a vehicle is told to be in is the true one beside which its centre line lies there.
    """
    here = {frame: (now, lanes) for (frame, _, now), lanes in zip(found.scans, found.maps, strict=True)}
    beside_of: dict[tuple[int, int], list[str]] = {}
    right, told, due = 0, 0, 0
    for f, row, state in zip(matches.frame, matches.row, matches.state, strict=True):
        number, vehicle = int(scene.number[f]), int(scene.rows.vehicle[row])
        lane = true[number, vehicle][0]
        since = scene.time_s[f] - scene.origin_s
        near = any(c.vehicle == vehicle and abs(c.t_s - since) <= AWAY_S for c in scene.changes)
        now, lanes = here[number]
        if near or lane not in {x.lane_id for x in scene.lanes} or not lanes.version:
            continue
        due += 1
        k = int(np.searchsorted(now.number, int(tracks.ids[tracks.track[state]])))
        mine = lanes.lane(int(now.lane[k]))
        if mine is None:
            continue
        key = (lanes.version, mine.index)
        if key not in beside_of:
            beside_of[key] = _true_beside(mine.points_m, scene)
        place = np.array([now.x_m[k], now.y_m[k]])
        told += 1
        right += beside_of[key][int(np.argmin(np.hypot(*(mine.points_m - place).T)))] == lane
    return {
        "lane_states": due, "lane_told": told / max(due, 1),
        "lane_right": right / told if told else math.nan,
    }  # fmt: skip


def _true_beside(points_m: np.ndarray, scene: Scene) -> list[str]:
    """Return the true lane that lies nearest to each point of a centre line."""
    names = [lane.lane_id for lane in scene.lanes]
    away = []
    for lane in scene.lanes:
        place = beside(points_m, lane.points)
        away.append(np.where(place.beyond, np.inf, np.abs(place.right_m)))
    return [names[k] for k in np.argmin(np.array(away), axis=0)]


def length_classes(
    scene: Scene, found: Run, tracks: RecordedTracks, matches: Matches, true: Labels
) -> dict[str, dict[str, int]]:
    """Vehicles by true kind and by the length class last told of the track that followed them for longest."""
    followed: dict[int, Counter[str]] = defaultdict(Counter)
    kind: dict[int, str] = {}
    for f, row, state in zip(matches.frame, matches.row, matches.state, strict=True):
        vehicle = int(scene.rows.vehicle[row])
        followed[vehicle][tracks.ids[tracks.track[state]]] += 1
        kind[vehicle] = true[int(scene.number[f]), vehicle][1]
    last = {
        str(number): length
        for _, _, now in found.scans
        for number, length in zip(now.number.tolist(), now.length_m.tolist(), strict=True)
        if not math.isnan(length)
    }
    table: dict[str, Counter[str]] = defaultdict(Counter)
    for vehicle, by_track in followed.items():
        track, frames = by_track.most_common(1)[0]
        if frames >= CLASSED_FRAMES:
            told = length_class(last.get(track), scene.site.length_bounds_m)
            table[kind[vehicle]][str(told)] += 1
    return {name: dict(row) for name, row in sorted(table.items())}


def measure_trajectories(path: Path, seed: int) -> dict[str, object]:
    """Lanes from the simulated radar's view of real vehicles; it looks along the road from before them."""
    truth = read_trajectories(path)
    away = np.column_stack([truth.x_m, truth.y_m])
    heading = math.atan2(float(truth.vx_mps.sum()), float(truth.vy_mps.sum()))
    ahead = np.array([math.sin(heading), math.cos(heading)])
    along = away @ ahead
    middle = np.median(away - along[:, None] * ahead, axis=0) + (along.min() - MAST_M) * ahead
    placed = truth.moved(x_m=float(middle[0]), y_m=float(middle[1]), heading_rad=heading)
    config = SensorConfig()
    found = run((s.frame for s in from_trajectories(placed, seed=seed)), config)
    content = json.loads(path.with_name(path.name.replace(".csv.gz", ".lanes.json")).read_text())
    turn = np.array([[math.cos(heading), math.sin(heading)], [-math.sin(heading), math.cos(heading)]])
    lines = _true_lanes(
        [(str(lane["lane_id"]), (np.array(lane["centerline"]) - middle) @ turn) for lane in content["lanes"]]
    )
    learned = [lane for lane in found.map.lanes if lane.kind == "lane"]
    places = np.column_stack([placed.x_m, placed.y_m])
    seen = (np.hypot(*places.T) > SIGHT_M[0]) & (np.hypot(*places.T) < SIGHT_M[1])
    partner: dict[str, float] = {}
    for name, parts in lines.items():
        inside = np.zeros(seen.sum(), dtype=np.bool_)
        for part in parts:
            place = beside(places[seen], part)
            inside |= ~place.beyond & (np.abs(place.right_m) < ONE_LANE_M)
        if len(set(placed.vehicle_id[seen][inside].tolist())) >= USED_BY:
            partner[name] = _nearest(np.concatenate(parts), learned)
    right = {name: away_m for name, away_m in partner.items() if away_m < NEAR_M}
    return {
        "scene": path.name.removesuffix(".csv.gz"), "vehicles": len(np.unique(truth.vehicle_id)),
        "lanes_true": len(partner), "lanes_found": len(learned), "lanes_right": len(right),
        "lane_offset_mean_m": float(np.mean(list(right.values()))) if right else math.nan,
        "offsets_m": {name: round(away_m, 2) for name, away_m in partner.items()}, **cost(found),
    }  # fmt: skip


def _true_lanes(parts: list[tuple[str, np.ndarray]]) -> dict[str, list[np.ndarray]]:
    """Return the parts of each lane; parts of one name that do not touch are lanes of their own (1, 1b, ...).

    In the data a ramp has the number of the leftmost lane.
    """
    lanes: dict[str, list[list[np.ndarray]]] = {}
    for name, points in parts:
        own = [points]
        apart = []
        for other in lanes.get(name, []):
            gaps = [np.hypot(*(points[:, None] - part).transpose(2, 0, 1)).min() for part in other]
            if min(gaps) < ONE_LANE_M:
                own += other
            else:
                apart.append(other)
        lanes[name] = [own, *apart]
    return {
        name + ("" if k == 0 else chr(ord("a") + k)): lane
        for name, found in lanes.items()
        for k, lane in enumerate(sorted(found, key=lambda lane: -sum(map(len, lane))))
    }


def _nearest(points: np.ndarray, learned: list[Lane]) -> float:
    """The mean distance of a true lane from the learned one that lies nearest to it."""
    sight = np.hypot(*points.T)
    points = points[(sight > SIGHT_M[0]) & (sight < SIGHT_M[1])]
    best = math.inf
    for lane in learned:
        place = beside(points, lane.points_m)
        if (~place.beyond).mean() > 0.4:
            best = min(best, float(np.abs(place.right_m[~place.beyond]).mean()))
    return best


def pooled(results: list[dict]) -> dict[str, object]:
    """Lane changes of all scenes together."""
    scenes = [r for r in results if "changes_true" in r]
    true, found = sum(r["changes_true"] for r in scenes), sum(r["changes_found"] for r in scenes)
    hits = sum(r["changes_recall"] * r["changes_true"] for r in scenes)
    whole = sum(r["complete_true"] for r in scenes)
    whole_hits = sum(r["complete_recall"] * r["complete_true"] for r in scenes if r["complete_true"])
    states = sum(r["lane_states"] * r["lane_told"] for r in scenes)
    classes: dict[str, Counter[str]] = defaultdict(Counter)
    for r in scenes:
        for kind, row in r["classes"].items():
            classes[kind].update(row)
    right = sum(r["lane_right"] * r["lane_states"] * r["lane_told"] for r in scenes if r["lane_told"])
    return {
        "scene": "pooled", "lane_right": right / max(states, 1),
        "classes": {kind: dict(row) for kind, row in sorted(classes.items())},
        "changes_true": true, "changes_found": found,
        "changes_recall": hits / max(true, 1), "changes_precision": hits / max(found, 1),
        "complete_true": whole, "complete_recall": whole_hits / max(whole, 1),
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("scenes", nargs="*", type=Path)
    parser.add_argument("--simulate", action="append", default=[], metavar="NAME:SEED[:SECONDS]")
    parser.add_argument("--trajectories", action="append", default=[], type=Path, metavar="CSV")
    parser.add_argument("--json", type=Path)
    chosen = parser.parse_args()
    results = []
    for directory in chosen.scenes:
        results.append(measure(directory))
        show(results[-1])
    for text in chosen.simulate:
        name, seed, *rest = text.split(":")
        with tempfile.TemporaryDirectory() as folder:
            write_scene(name, Path(folder), seed=int(seed), duration_s=float(rest[0]) if rest else None)
            results.append(measure(Path(folder)) | {"scene": f"simulated {text}"})
        show(results[-1])
    for path in chosen.trajectories:
        results.append(measure_trajectories(path, seed=1))
        show(results[-1])
    results.append(pooled(results))
    show(results[-1])
    if chosen.json is not None:
        about = {"version": __version__, "machine": platform.machine(), "results": results}
        chosen.json.write_text(json.dumps(about, indent=1, default=float) + "\n")


def show(result: dict[str, object]) -> None:
    print(
        " ".join(f"{k}={v:.3f}" if isinstance(v, float) else f"{k}={v}" for k, v in result.items()),
        flush=True,
    )


if __name__ == "__main__":
    main()
