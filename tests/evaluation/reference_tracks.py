"""Make tracker outputs of known faults from a scene's truth, and write what the reference says of them.

    python reference_tracks.py SCORER_DIRECTORY OUT_DIRECTORY

needs an interpreter that has numpy, scipy and trackeval; SCORER_DIRECTORY holds score.py and data/SCENE/. The
tests make the same outputs (seeded; only numpy and the standard library) and compare with what is stored.
"""

from __future__ import annotations

import csv
import gzip
import json
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np

SCENES = ("free_flow", "dense", "stop_and_go", "two_way", "curve", "intersection", "wide")
VARIANTS = ("perfect", "thinned", "noisy", "early", "empty")
UNTIL_S = {"early": 20.0, "empty": 30.0}
_ORIGIN = datetime.fromisoformat("2025-05-12T06:00:00+00:00")


@dataclass
class Truth:
    name: str
    road: dict
    frames: list[tuple[int, str]]  # number, timestamp
    rows: dict[int, np.ndarray]  # by frame: id, x, y, vx, vy, length


def read(scene: Path) -> Truth:
    with gzip.open(scene / "frames.jsonl.gz", "rt") as lines:
        heads = (json.loads(line[: line.index('"detections"')].rstrip(", ") + "}") for line in lines)
        frames = [(head["frame"], head["timestamp"]) for head in heads]
    rows: dict[int, list] = {number: [] for number, _ in frames}
    with gzip.open(scene / "truth.csv.gz", "rt") as lines:
        for row in csv.DictReader(lines):
            values = [float(row[k]) for k in ("id", "x", "y", "vx", "vy", "length")]
            rows[int(row["frame"])].append(values)
    arrays = {number: np.array(here).reshape(-1, 6) for number, here in rows.items()}
    return Truth(scene.name, json.loads((scene / "road_truth.json").read_text()), frames, arrays)


def write(truth: Truth, variant: str, directory: Path) -> dict[str, Path]:
    """Write the files of one variant and return them by the names tracks, flow, lanes, changes."""
    rng = np.random.default_rng([SCENES.index(truth.name), VARIANTS.index(variant)])
    make = {"perfect": _perfect, "thinned": _thinned, "noisy": _noisy, "early": _perturbed}
    out = {"tracks": directory / "tracks.jsonl"}
    _write(out["tracks"], make[variant](truth, rng) if variant in make else ())
    if variant in {"thinned", "noisy", "early"}:
        contents = {
            "flow": _flow(truth.road, rng),
            "lanes": [{"lanes": list(_lanes(truth.road, rng))}],
            "changes": _changes(truth.road, rng),
        }
        for name, content in contents.items():
            out[name] = directory / f"{name}.jsonl"
            _write(out[name], content)
    return out


def _write(path: Path, lines) -> None:
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))


def _state(track_id, values, **more) -> dict:
    x, y, vx, vy = values
    return {"track_id": track_id, "x": x, "y": y, "vx": vx, "vy": vy, **more}


def _perfect(truth: Truth, _rng) -> Iterator[dict]:
    for number, time in truth.frames:
        tracks = [_state(int(r[0]), r[1:5]) for r in truth.rows[number].tolist()]
        yield {"frame": number, "timestamp": time, "tracks": tracks}


def _perturbed(truth: Truth, rng) -> Iterator[dict]:
    """Add noise; names are text, keys carry units."""
    for number, time in truth.frames:
        rows = truth.rows[number]
        states = rng.normal(rows[:, 1:5], (0.4, 0.4, 0.5, 0.5)).tolist()
        keys = ("x_m", "y_m", "vx_mps", "vy_mps")
        tracks = [
            {"track_id": f"radar-1-1-{int(row[0])}", "status": "confirmed", **dict(zip(keys, s, strict=True))}
            for row, s in zip(rows, states, strict=True)
        ]
        yield {"frame": number, "timestamp": time, "tracks": tracks}


def _thinned(truth: Truth, rng) -> Iterator[dict]:
    """Leave out states and whole vehicles, swap and renew identities, change status."""
    names: dict[int, int] = {}
    renewed = 0
    kinds = ("confirmed", "coasted", "coasting", "tentative")
    for number, time in truth.frames:
        rows = truth.rows[number]
        ids = [int(k) for k in rows[:, 0]]
        for vehicle, chance in zip(ids, rng.random(len(ids)), strict=True):
            if vehicle not in names or chance < 0.004:
                renewed += 1
                names[vehicle] = renewed
        if len(ids) > 1 and rng.random() < 0.02:
            a, b = (ids[k] for k in rng.choice(len(ids), 2, replace=False))
            names[a], names[b] = names[b], names[a]
        status = rng.choice(4, len(ids), p=(0.85, 0.05, 0.05, 0.05))
        seen = rng.random(len(ids)) > 0.1
        states = rng.normal(rows[:, 1:5], (0.2, 0.2, 0.0, 0.0)).tolist()
        tracks = [
            _state(names[vehicle], states[k], status=kinds[status[k]])
            for k, vehicle in enumerate(ids)
            if vehicle % 7 and seen[k]
        ]
        yield {"frame": number, "timestamp": time, "tracks": tracks}


def _noisy(truth: Truth, rng) -> Iterator[dict]:
    """Add noise, drift, standing and second tracks; one line a track, some with a time only, some strange."""
    for number, time in truth.frames:
        late = timedelta(milliseconds=float(rng.uniform(-9, 9)))
        moment = (datetime.fromisoformat(time) + late).isoformat().replace("+00:00", "Z")
        key = {"frame": number} if number % 3 == 0 else {"timestamp": moment}
        rows = truth.rows[number]
        noisy = rng.normal(rows[:, 1:5], (0.5, 0.5, 0.0, 0.0))
        noisy[:, 0] += 0.8 * np.sin(number / 40 + rows[:, 0])
        second = (rows[:, 5] > 7) & (rng.random(len(rows)) < 0.8)
        for row, state, double in zip(rows.tolist(), noisy.tolist(), second, strict=True):
            yield {**key, **_state(int(row[0]) % 11 + 1000 * (number // 200), state)}
            if double:
                yield {**key, **_state(f"tail-{int(row[0])}", (row[1], row[2] + 4.5, *row[3:5]))}
        for k in range(3):
            yield {**key, "track_id": f"post-{k}", "x": -6.0 + 5 * k, "y": 40.0 + 30 * k}
        yield {**key, "track_id": f"flash-{number // 4}", "x": rng.uniform(-8, 8), "y": rng.uniform(30, 120)}
    yield {"frame": 10**6, "track_id": 1, "x": 0.0, "y": 50.0, "vx": 0.0, "vy": 0.0}


def _flow(road: dict, rng) -> Iterator[dict]:
    """Move, lose and double crossings; name the lane by place, by a learned lane, or by the true name."""
    for n, q in enumerate(road["crossings"]):
        if rng.random() < 0.08:
            continue
        t = q["t"] + rng.normal(0, 0.2)
        event = {"line_id": q["line_id"], "speed_mps": q["speed_mps"] + rng.normal(0, 0.5)}
        event |= {"t": t} if n % 5 == 0 else {"timestamp": _time(t)}
        if n % 4 != 1:
            event |= {"x": q["x"] + rng.normal(0, 0.8), "y": q["y"]}
        if n % 4 != 2:
            event |= {"lane_id": f"found-{q['lane_id']}" if n % 2 else q["lane_id"]}
        yield event
        if rng.random() < 0.06:
            yield {**event, "speed_mps": 1.0}
    yield {"line_id": "nowhere", "timestamp": _time(12.0), "lane_id": "L1", "speed_mps": 9.0}


def _lanes(road: dict, rng) -> Iterator[dict]:
    """Shift the true lanes, leave some out, add a half one, one beside the road and one that is no line."""
    for n, lane in enumerate(road["lanes"]):
        points = np.array(lane["points"])
        if n % 5 == 4:
            continue
        moved = points + np.array([rng.normal(0, 0.3), 0.0]) + rng.normal(0, 0.05, points.shape)
        yield {"lane_id": f"found-{lane['lane_id']}", "points": moved[3:-3].tolist()}
        if n == 0:
            half = points[: len(points) // 2] + np.array([0.6, 0.0])
            yield {"lane_id": "half", "points": half.tolist()}
    yield {"lane_id": "extra", "points": [[-30.0, 20.0], [-30.0, 120.0]]}
    yield {"lane_id": "dot", "points": [[1.0, 2.0]]}


def _changes(road: dict, rng) -> Iterator[dict]:
    for q in road["lane_changes"]:
        if rng.random() < 0.8:
            track = rng.choice([q["id"], q["id"] % 11, 3])
            yield {"timestamp": _time(max(0.0, q["t"] + rng.normal(0, 1.5))), "track_id": int(track)}
            yield {"timestamp": _time(max(0.0, q["t"])), "track_id": f"radar-1-1-{q['id']}"}
    yield {"timestamp": _time(9.0), "track_id": "nobody"}


def _time(seconds: float) -> str:
    moment = _ORIGIN + timedelta(seconds=float(seconds))
    return moment.isoformat(timespec="milliseconds").replace("+00:00", "Z")


def main(scorer: Path, out: Path) -> None:
    sys.path.insert(0, str(scorer))
    from score import score_scene  # noqa: PLC0415 - found only with the path above

    for scene in SCENES:
        truth, results = read(scorer / "data" / scene), {}
        for variant in VARIANTS:
            with tempfile.TemporaryDirectory() as directory:
                files = {name: str(p) for name, p in write(truth, variant, Path(directory)).items()}
                tracks = files.pop("tracks")
                until = UNTIL_S.get(variant)
                found = score_scene(str(scorer / "data" / scene), tracks, until=until, **files)
            results[variant] = {k: None if v != v else v for k, v in found.items()}  # noqa: PLR0124 - NaN
        text = json.dumps(results, indent=1, default=float)
        (out / f"reference_scores_{scene}.json").write_text(text + "\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
