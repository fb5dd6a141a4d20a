"""Write a scene of a few vehicles on straight lanes whose scores can be worked out by hand."""

from __future__ import annotations

import gzip
import json
from dataclasses import dataclass, field
from pathlib import Path

FRAMES = 200
STEP_S = 0.05
HEADER = "frame,time,id,class,x,y,vx,vy,heading_deg,length,width,lane,n_det,visible\n"


@dataclass
class Vehicle:
    """A car that drives straight on at x, from y0 with speed vy; it is detected from frame `seen_from`."""

    id: int
    x: float
    y0: float
    vy: float
    seen_from: int = 0
    seen_until: int = FRAMES
    length: float = 4.0
    width: float = 2.0

    def y(self, frame: int) -> float:
        return self.y0 + self.vy * frame * STEP_S


@dataclass
class SmallScene:
    vehicles: list[Vehicle]
    lanes: dict[str, float] = field(default_factory=lambda: {"L1": -2.0, "L2": 2.0})
    line_y: float = 80.0

    def lane_of(self, vehicle: Vehicle) -> str:
        return min(self.lanes, key=lambda name: abs(self.lanes[name] - vehicle.x), default="none")

    def write(self, directory: Path) -> Path:
        site = {
            "scene": "small",
            "sensor_id": "radar-1",
            "region": {"range_min_m": 20.0, "range_max_m": 150.0, "azimuth_max_deg": 45.0},
            "count_lines": [{"line_id": "C", "p0": [-5.0, self.line_y], "p1": [5.0, self.line_y]}],
        }
        (directory / "site.json").write_text(json.dumps(site))
        (directory / "road_truth.json").write_text(json.dumps(self.road()))
        with gzip.open(directory / "frames.jsonl.gz", "wt") as out:
            for k in range(FRAMES):
                frame = {"sensor_id": "radar-1", "timestamp": stamp(k), "frame": k, "detections": []}
                out.write(json.dumps(frame) + "\n")
        with gzip.open(directory / "truth.csv.gz", "wt") as out:
            out.write(HEADER)
            for k in range(FRAMES):
                for v in self.vehicles:
                    heading = 0.0 if v.vy > 0 else 180.0
                    seen = int(v.seen_from <= k < v.seen_until)
                    out.write(f"{k},-,{v.id},car,{v.x},{v.y(k)!r},0.0,{v.vy},{heading},{v.length},{v.width},")
                    out.write(f"{self.lane_of(v)},{seen},1.0\n")
        return directory

    def road(self) -> dict:
        crossings = []
        for v in self.vehicles:
            t = (self.line_y - v.y0) / v.vy
            if 0 <= t <= (FRAMES - 1) * STEP_S:
                place = {"line_id": "C", "lane_id": self.lane_of(v), "x": v.x, "y": self.line_y}
                crossings.append({**place, "t": t, "id": v.id, "cls": "car", "speed_mps": abs(v.vy)})
        lanes = [
            {"lane_id": name, "points": [[x, float(y)] for y in range(20, 150, 2)]}
            for name, x in self.lanes.items()
        ]
        return {"lanes": lanes, "crossings": sorted(crossings, key=lambda q: q["t"]), "lane_changes": []}

    def tracks(self, change=None) -> list[dict]:
        """Return perfect tracks line by line; change(frame, vehicle, state) edits or drops (None) one."""
        lines = []
        for k in range(FRAMES):
            for v in self.vehicles:
                state = {"track_id": v.id, "x": v.x, "y": v.y(k), "vx": 0.0, "vy": v.vy}
                state = change(k, v, state) if change else state
                if state is not None:
                    lines.append({"frame": k, **state})
        return lines


def stamp(frame: int) -> str:
    return f"2025-05-12T06:00:{frame * STEP_S:06.3f}Z"


def write_lines(path: Path, lines: list[dict]) -> Path:
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    return path
