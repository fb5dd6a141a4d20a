"""Say of every identity switch, missed vehicle and false track of a scene what went wrong.

    python -m benchmarks.diagnosis SCENE_DIR... [--until S] [--set key=value]... [--switches]

Matching is the scorer's. The scene needs labels.jsonl.gz, which tells the vehicle behind every detection, so
that each point can be followed: dropped as clutter, claimed by the right track, by another, or by none. After
the causes stand the scores that the same run would have with perfect identities, without its false tracks,
and with its missed vehicles left out: what repairing each kind of error could gain at most. --switches lists
the switches one by one.
"""

from __future__ import annotations

import argparse
import gzip
import json
import math
import os
import sys
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")  # before numpy is imported
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np  # noqa: E402

from service.evaluation.clear import keep_partners  # noqa: E402
from service.evaluation.counted import Counted, count  # noqa: E402
from service.evaluation.hota import hota  # noqa: E402
from service.evaluation.recorded import RecordedTracks, record  # noqa: E402
from service.evaluation.rules import RULES  # noqa: E402
from service.evaluation.scene_runs import Job, configured, states_of  # noqa: E402
from service.evaluation.sequence import labelled  # noqa: E402
from service.evaluation.truth import Scene, read_scene  # noqa: E402
from service.formats.json_frames import read_frames  # noqa: E402
from service.tracking import tracker  # noqa: E402
from service.tracking.assigning import Assignment  # noqa: E402
from service.tracking.merging import MergingParameters  # noqa: E402
from service.tracking.model import I64, Bool, TrackStatus  # noqa: E402
from service.tracking.points import point_array  # noqa: E402
from service.tracking.state import Tracks  # noqa: E402

CLUTTER, FREE = -2, -1  # what became of a point that no track claimed
RECENT_FRAMES = 10  # in which points tell what a vehicle or a track lives on
NO_POINTS = 0.15  # a frame: fewer are none
ASIDE_M, AHEAD_M = 1.5, 5.0  # further than this from a vehicle's centre a track has left it
SOURCES = {0: "clutter", -1: "false alarm", -2: "ghost"}


@dataclass(frozen=True, slots=True)
class Step:
    """One frame: the vehicle behind each point, the track that claimed it, all tracks, and those merged."""

    source: I64  # (N,) vehicle, or a key of SOURCES
    owner: I64  # (N,) number of a track, FREE or CLUTTER
    tracks: dict[int, tuple[float, float, bool]]  # x, y, confirmed by number
    merged: frozenset[int]


def follow(folder: Path, scene: Scene, settings: tuple[str, ...]) -> tuple[list[Step], RecordedTracks]:
    """Track the scene and return what became of every point, and the tracks as they are scored."""
    p = configured(scene.site, Job(folder, settings=settings)).tracker_parameters()
    with gzip.open(folder / "labels.jsonl.gz", "rt") as lines:
        label = {q["frame"]: np.array(q["src"], dtype=np.int64) for q in map(json.loads, lines)}
    seen: dict[str, Any] = {}
    assign, merge = tracker.assign, tracker.merge

    def watched_assign(*given: Any) -> Assignment:  # noqa: ANN401 - passed on
        tracks, points, found = given[0], given[5], assign(*given)
        numbers = np.append(tracks.number, FREE)  # the owner -1 is the last
        seen.update(points=points, owner=numbers[found.owner])
        return found

    def watched_merge(tracks: Tracks, parameters: MergingParameters) -> tuple[Tracks, Bool]:
        after, drop = merge(tracks, parameters)
        seen.update(merged=frozenset(tracks.number[drop].tolist()))
        return after, drop

    steps, states, state = [], [], tracker.initial_state(p)
    wanted = set(scene.number.tolist())
    with patch.object(tracker, "assign", watched_assign), patch.object(tracker, "merge", watched_merge):
        for frame in read_frames(sorted(folder.glob("frames.jsonl*")), scene.site):
            if frame.sequence not in wanted:
                continue
            state, found, _ = tracker.step(state, frame, p)
            states.append(states_of(found))
            owner = np.full(len(frame), CLUTTER)
            place = {row.tobytes(): k for k, row in enumerate(point_array(frame, p.sensor))}
            owner[[place[row.tobytes()] for row in seen["points"]]] = seen["owner"]
            t = state.tracks
            sure = (t.status != TrackStatus.TENTATIVE).tolist()
            here = dict(
                zip(t.number.tolist(), zip(t.x_m.tolist(), t.y_m.tolist(), sure, strict=True), strict=True)
            )
            steps.append(Step(label[frame.sequence], owner, here, seen["merged"]))
    return steps, record(states)


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """A tracked scene, held against its truth."""

    scene: Scene
    steps: list[Step]
    tracks: RecordedTracks
    counted: Counted
    matched: list[dict[int, int]]  # the track of each matched vehicle, frame by frame
    switches: list[tuple[int, int, int, int, int]]  # frame, vehicle, frame before, track before, track

    def offset(self, frame: int, number: int, vehicle: int) -> tuple[float, float] | None:
        """Return how far ahead of the vehicle and to its right the track is; None: one is not there."""
        rows = self.scene.rows
        here = np.arange(rows.start[frame], rows.start[frame + 1])
        here = here[rows.vehicle[here] == vehicle]
        track = self.steps[frame].tracks.get(number)
        if track is None or not len(here):
            return None
        dx, dy = track[0] - rows.x_m[here[0]], track[1] - rows.y_m[here[0]]
        s, c = math.sin(rows.heading_rad[here[0]]), math.cos(rows.heading_rad[here[0]])
        return s * dx + c * dy, c * dx - s * dy

    def fate(self, vehicle: int, end: int) -> Counter[int]:
        """Return how many of the vehicle's last points each track claimed, FREE and CLUTTER among them."""
        recent = self.steps[max(end - RECENT_FRAMES, 0) : end]
        return Counter(int(o) for step in recent for o in step.owner[step.source == vehicle])

    def diet(self, number: int, end: int) -> Counter[int]:
        """Return how many of the track's last points came from each vehicle or from what else."""
        recent = self.steps[max(end - RECENT_FRAMES, 0) : end]
        return Counter(int(s) for step in recent for s in step.source[step.owner == number])

    def why_switched(self, frame: int, vehicle: int, before: int, old: int) -> str:
        """Return what became of the old track of a vehicle that has a new one."""
        if old in self.steps[frame].tracks:
            here = self.matched[frame]
            return "alive, on another vehicle" if old in here.values() else "alive, off the vehicle"
        end = next(f for f in range(before, frame + 1) if old not in self.steps[f].tracks)
        if old in self.steps[end].merged:
            return "merged into another track"
        fate, at = self.fate(vehicle, end), self.offset(max(end - 1, 0), old, vehicle)
        total = sum(fate.values())
        if total < NO_POINTS * RECENT_FRAMES:
            return "ended, the vehicle gave no points"
        if fate[CLUTTER] > total / 2:
            return "ended, its points were taken for clutter"
        if at is None or abs(at[1]) > ASIDE_M or abs(at[0]) > AHEAD_M:
            return "ended, away from the vehicle"
        return (
            "ended, points claimed by others"
            if fate[old] + fate[FREE] < total / 2
            else "ended on the vehicle"
        )

    def why_missed(self, frame: int, vehicle: int) -> str:
        """Return what became of the points of a vehicle without a track."""
        fate = self.fate(vehicle, frame + 1)
        total = sum(fate.values())
        near = [n for n in self.steps[frame].tracks if self._beside(frame, n, vehicle)]
        if total < NO_POINTS * RECENT_FRAMES:
            return "gave no points"
        if fate[CLUTTER] > total / 2:
            return "points taken for clutter"
        if any(self.steps[frame].tracks[n][2] for n in near):
            return "a track is near, but misplaced or of another"
        if near:
            return "its track is tentative"
        return "points free, nothing born" if fate[FREE] > total / 2 else "points claimed by others"

    def why_false(self, frame: int, number: int) -> str:
        """Return what a track that is on no vehicle lives on."""
        diet = self.diet(number, frame + 1)
        if not diet:
            return "coasts without points"
        source = diet.most_common(1)[0][0]
        if source <= 0:
            return f"points of {SOURCES[source]}"
        return (
            "points of a vehicle that has a track"
            if source in self.matched[frame]
            else "displaced from its vehicle"
        )

    def _beside(self, frame: int, number: int, vehicle: int) -> bool:
        at = self.offset(frame, number, vehicle)
        return at is not None and abs(at[1]) < ASIDE_M and abs(at[0]) < AHEAD_M


def diagnose(folder: Path, until_s: float | None = None, settings: tuple[str, ...] = ()) -> Diagnosis:
    """Track a scene and match its tracks with its vehicles as CLEAR MOT does."""
    scene = read_scene(folder)
    scene = scene if until_s is None else scene.until(until_s)
    steps, tracks = follow(folder, scene, settings)
    counted = count(scene, tracks, RULES)
    matched: list[dict[int, int]] = []
    partner: dict[int, int] = {}
    last: dict[int, tuple[int, int]] = {}
    switches = []
    for f, frame in enumerate(counted.frames):
        vehicles = scene.rows.vehicle[frame.vehicles]
        numbers = np.array([int(tracks.ids[k]) for k in tracks.track[frame.tracks]], dtype=np.int64)
        matched.append({})
        if not len(vehicles) or not len(numbers):
            continue
        before = np.array([partner.get(int(v), -1) for v in vehicles])
        similarity = np.maximum(0.0, 1.0 - frame.distance_m / RULES.cutoff_m)
        rows, columns = keep_partners(before, numbers, similarity, 1.0 - RULES.gate_m / RULES.cutoff_m)
        partner = {int(vehicles[i]): int(numbers[j]) for i, j in zip(rows, columns, strict=True)}
        for vehicle, number in partner.items():
            if vehicle in last and last[vehicle][1] != number:
                switches.append((f, vehicle, *last[vehicle], number))
            last[vehicle] = f, number
        matched[f] = dict(partner)
    return Diagnosis(scene, steps, tracks, counted, matched, switches)


def causes(d: Diagnosis) -> dict[str, Counter[str]]:
    """Return how often each cause stands behind the switches, the missed vehicles and the false tracks."""
    found = {
        "identity switches": Counter(),
        "missed vehicle-frames": Counter(),
        "false track-frames": Counter(),
    }
    found["identity switches"].update(d.why_switched(*switch[:4]) for switch in d.switches)
    for f, frame in enumerate(d.counted.frames):
        missed = set(d.scene.rows.vehicle[frame.vehicles].tolist()) - d.matched[f].keys()
        false = {int(d.tracks.ids[k]) for k in d.tracks.track[frame.tracks]} - set(d.matched[f].values())
        found["missed vehicle-frames"].update(d.why_missed(f, vehicle) for vehicle in missed)
        found["false track-frames"].update(d.why_false(f, number) for number in false)
    return found


def ceilings(d: Diagnosis) -> dict[str, float]:
    """Return the HOTA of the run, and of the same run with one kind of error repaired."""
    vehicles, numbers, distances = [], [], []
    for frame in d.counted.frames:
        vehicles.append(d.scene.rows.vehicle[frame.vehicles])
        numbers.append(np.array([int(d.tracks.ids[k]) for k in d.tracks.track[frame.tracks]], dtype=np.int64))
        distances.append(frame.distance_m)
    stranger = int(d.scene.rows.vehicle.max(initial=0)) + 1
    owner = [{n: v for v, n in here.items()} for here in d.matched]
    renamed = [
        np.array([names.get(int(n), stranger + int(n)) for n in here], dtype=np.int64)
        for here, names in zip(numbers, owner, strict=True)
    ]
    true = [
        np.array([int(n) in names for n in here], dtype=np.bool_)
        for here, names in zip(numbers, owner, strict=True)
    ]
    held = [
        np.array([int(v) in here for v in who], dtype=np.bool_)
        for who, here in zip(vehicles, d.matched, strict=True)
    ]
    runs = {
        "as it is": (vehicles, numbers, distances),
        "with perfect identities": (vehicles, renamed, distances),
        "without false tracks": (
            vehicles,
            [n[keep] for n, keep in zip(numbers, true, strict=True)],
            [m[:, keep] for m, keep in zip(distances, true, strict=True)],
        ),
        "without missed vehicles": (
            [v[keep] for v, keep in zip(vehicles, held, strict=True)],
            numbers,
            [m[keep] for m, keep in zip(distances, held, strict=True)],
        ),
    }
    return {name: float(np.mean(hota(labelled(*run, RULES.cutoff_m)).hota)) for name, run in runs.items()}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scenes", nargs="+", type=Path, metavar="SCENE_DIR")
    parser.add_argument("--until", type=float, help="only the first so many seconds")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", dest="settings")
    parser.add_argument("--switches", action="store_true", help="list every identity switch")
    options = parser.parse_args()
    for folder in options.scenes:
        d = diagnose(folder, options.until, tuple(options.settings))
        print(f"## {d.scene.name}: {len(d.steps)} frames\n")
        for kind, found in causes(d).items():
            print(f"{found.total()} {kind}")
            for cause, times in found.most_common():
                print(f"{times:7d}  {cause}")
        print("HOTA " + ", ".join(f"{value:.3f} {name}" for name, value in ceilings(d).items()))
        for f, vehicle, before, old, new in d.switches if options.switches else ():
            time_s = d.scene.time_s[f] - d.scene.time_s[0]
            cause = d.why_switched(f, vehicle, before, old)
            who = f"vehicle {vehicle}: track {old} -> {new}, {f - before} frames on"
            print(f"  {time_s:6.2f} s  {who}; {old}: {cause}")
        print()


if __name__ == "__main__":
    main()
