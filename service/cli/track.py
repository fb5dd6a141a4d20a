"""`wayside track`: recorded frames to tracks, by the same fold as the service."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import orjson
import typer

from service.cli import options
from service.cli.count_files import COUNT_FILES, CountFiles
from service.cli.edge import one_sentence
from service.cli.output import json_text, print_facts, print_json, progress, provenance
from service.formats.rfc3339 import format_time

if TYPE_CHECKING:
    from rich.progress import Progress

    from service.formats.sensor import SensorConfig
    from service.pipeline.fold_state import FoldState
    from service.storage.rows import EventRow, LaneChangeRow, TrackKey, TrackSummary
    from service.tracking.model import Frame

FILES = (
    "tracks.jsonl", "track_summaries.jsonl", *COUNT_FILES, "changes.jsonl", "events.jsonl", "lanes.json",
    "lanes.geojson", "summary.json",
)  # fmt: skip


@one_sentence()
def track(
    frames: Annotated[list[Path], typer.Argument(metavar="FRAMES...", help="JSON lines, gzip or not.")],
    site: options.Site,
    out: options.Out,
    *,
    profile: options.Profile = None,
    filter_name: options.Filter = None,
    settings: options.Set = None,
    force: options.Force = False,
    show: options.ShowProgress = None,
    as_json: options.Json = False,
) -> None:
    """Track recorded frames and write what was found into a folder."""
    from service.cli.results import written_together
    from service.cli.site_file import read_site
    from service.formats.json_frames import read_frames
    from service.traffic.parameters import traffic_setup

    config = read_site(site, filter_name, settings or (), profile)
    begun_s = time.monotonic()
    with written_together(out, FILES, force=force) as folder, progress(wanted=show) as bar:
        counted = _Counted(read_frames(frames, config), bar, frames)
        tally = _write(folder, config, counted)
        summary = provenance(config.tracker_parameters()) | {"sensor_id": config.sensor_id}
        summary["traffic_digest"] = traffic_setup(config).parameters.digest()
        summary |= counted.summary() | tally | {"elapsed_s": round(time.monotonic() - begun_s, 3)}
        (folder / "summary.json").write_text(json_text(summary) + "\n")
    if as_json:
        print_json(summary | {"out": str(out)})
    else:
        print_facts(f"Tracks of {config.sensor_id} -> {out}", summary)


class _Counted:
    """The frames on their way into the fold, counted."""

    def __init__(self, frames: Iterator[Frame], bar: Progress, paths: list[Path]) -> None:
        from service.cli.recording import count_lines

        self.frames = self.points = 0
        self.first_us: int | None = None
        self.last_us = 0
        self._source, self._bar = frames, bar
        total = None if bar.disable else count_lines(paths)
        self._task = bar.add_task("tracking", total=total)

    def __iter__(self) -> Iterator[Frame]:
        for frame in self._source:
            self.frames += 1
            self.points += len(frame)
            self.first_us = frame.time_us if self.first_us is None else min(self.first_us, frame.time_us)
            self.last_us = max(self.last_us, frame.time_us)
            self._bar.advance(self._task)
            yield frame

    def summary(self) -> dict[str, object]:
        known = self.first_us is not None
        return {
            "frames": self.frames,
            "points": self.points,
            "start": format_time(self.first_us) if self.first_us is not None else None,
            "end": format_time(self.last_us) if known else None,
        }


def _write(folder: Path, config: SensorConfig, frames: Iterable[Frame]) -> dict[str, object]:
    """Write the lines of every frame as it is folded, then what the end tells; return the counts."""
    from service.api.track_schemas import EventReply, track_fields
    from service.cli.lane_files import change_lines, write_lanes
    from service.formats.tracks import frame_line
    from service.pipeline.fold import at_an_end
    from service.pipeline.offline import fold_frames

    tracks: dict[TrackKey, TrackSummary] = {}
    fates: Counter[str] = Counter()
    epoch, states, missing = 1, 0, 0
    changes: list[LaneChangeRow] = []
    events: list[EventRow] = []
    counts = CountFiles(config)
    ends: list[FoldState[Any]] = []
    with (folder / "tracks.jsonl").open("wb") as lines:
        for output in fold_frames(frames, config, at_end=ends.append):
            epoch += output.restarted is not None
            fates[output.fate.value] += 1
            missing += output.missing
            events += output.rows.events
            changes += output.rows.lane_changes
            counts.add(output.rows)
            tracks.update((row.key, row) for row in output.rows.tracks)
            for scan in output.frames:
                states += len(scan.estimates)
                line = frame_line(config.sensor_id, epoch, scan.number, scan.time_us, scan.estimates)
                lines.write(line + b"\n")
    lane_map, late = at_an_end(ends[0])
    changes += late.lane_changes
    counts.add(late)
    with (folder / "track_summaries.jsonl").open("wb") as lines:
        for key in sorted(tracks, key=lambda key: (key.epoch, key.number)):
            lines.write(orjson.dumps(track_fields(tracks[key])) + b"\n")
    (folder / "changes.jsonl").write_bytes(change_lines(changes))
    told = [EventReply.of(event).model_dump_json() + "\n" for event in events]
    (folder / "events.jsonl").write_text("".join(told))
    return (
        {
            "tracks": len(tracks),
            "lane_changes": len(changes),
            "states": states,
            "missing_frames": missing,
            "duplicate_frames": fates["duplicate"],
            "late_frames": fates["late"],
            "conflicting_frames": fates["conflict"],
            "restarts": epoch - 1,
            "events": len(events),
        }
        | counts.write(folder)
        | write_lanes(folder, config, lane_map)
    )
