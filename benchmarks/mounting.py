"""Turn recorded frames by known angles, and print by how much the doctor says that the radar is turned.

    python benchmarks/mounting.py SCENE_DIR... [--frames 800] [--json OUT.json]

Every azimuth of a scene is turned by 0, +-0.5, +-1 and +-2 deg, or mirrored, and the scene is tracked again.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from dataclasses import replace
from itertools import islice
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")  # before numpy is imported
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np  # noqa: E402

from service.formats.json_frames import read_frames  # noqa: E402
from service.formats.sensor import SensorConfig  # noqa: E402
from service.pipeline.diagnosing import diagnose_recording  # noqa: E402
from service.tracking.model import Frame  # noqa: E402

TURNS_DEG = (-2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0)
BAR_DEG = 0.3


def turned(frames: list[Frame], degrees: float) -> list[Frame]:
    shift = np.float32(np.radians(degrees))
    return [replace(frame, azimuth_rad=frame.azimuth_rad + shift) for frame in frames]


def mirrored(frames: list[Frame]) -> list[Frame]:
    return [replace(frame, azimuth_rad=-frame.azimuth_rad) for frame in frames]


def measure(directory: Path, count: int) -> dict[str, object]:
    """Return what the doctor says of one scene, turned and mirrored."""
    config = SensorConfig.model_validate_json((directory / "site.json").read_text())
    frames = list(islice(read_frames([directory / "frames.jsonl.gz"], config), count))
    told: dict[str, object] = {}
    for degrees in TURNS_DEG:
        found = diagnose_recording(turned(frames, degrees), config)
        told[f"{degrees:+g}"] = {
            "yaw_deg": found.measured.get("yaw_deg"),
            "standard_error_deg": found.measured.get("yaw_standard_error_deg"),
            "codes": [finding.code for finding in found.findings],
            "not_told": found.not_told[-1:],
        }
    found = diagnose_recording(mirrored(frames), config)
    return {"turned": told, "mirrored": [finding.code for finding in found.findings]}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scenes", type=Path, nargs="+")
    parser.add_argument("--frames", type=int, default=800)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    result = {"bar_deg": BAR_DEG, "frames": given.frames, "scenes": {}}
    for directory in given.scenes:
        found = measure(directory, given.frames)
        result["scenes"][directory.name] = found
        row = [
            "-" if item["yaw_deg"] is None else f"{item['yaw_deg']:+.2f}" for item in found["turned"].values()
        ]
        print(directory.name, *row, "mirrored:", *found["mirrored"], flush=True)
    if given.json:
        given.json.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
