"""Turn movements, evidence and counts by hand into the fields of replies, and requests into counts."""

from __future__ import annotations

from collections.abc import Sequence

from sqlalchemy import Connection

from service.api.flow_schemas import ManualCountInput
from service.api.track_schemas import track_fields
from service.errors import InvalidInput, NotFound
from service.formats.rfc3339 import format_time, parse_time_us
from service.storage.flow import Evidence
from service.storage.manual_counts import Checked, ManualCount
from service.storage.rows import TrackKey
from service.storage.tracks import read_track
from service.traffic.flow import Group
from service.traffic.flow_fields import Fields, crossing_fields, flow_fields, lane_id
from service.traffic.movements import Movement


def movement_fields(found: Sequence[Movement]) -> list[Fields]:
    """Return the fields of each movement."""
    return [
        {
            "start": format_time(row.start_us),
            "end": format_time(row.end_us),
            "entry": row.entry,
            "exit": row.exit,
            "length_class": row.length_class,
            "volume": row.volume,
            "expected": row.expected,
        }
        for row in found
    ]


def evidence_fields(reader: Connection, sensor_id: str, evidence: Evidence) -> Fields:
    """Return the fields of an EvidenceReply; tracks that are stored no more are left out."""
    c = evidence.crossings
    tracks = []
    for epoch, number in sorted(set(zip(c.epoch.tolist(), c.track.tolist(), strict=True))):
        try:
            tracks.append(track_fields(read_track(reader, TrackKey(sensor_id, epoch, number))))
        except NotFound:
            continue  # its retention may be shorter than that of counts
    frames: Fields = {"first": None, "last": None, "start": None, "end": None}
    if len(c):
        times, numbers = c.time_us, c.frame
        frames = {
            "first": int(numbers.min()),
            "last": int(numbers.max()),
            "start": format_time(int(times.min())),
            "end": format_time(int(times.max())),
        }
    return {
        "flow": flow_fields(sensor_id, evidence.flow)[0],
        "crossings": crossing_fields(sensor_id, c),
        "tracks": tracks,
        "frames": frames,
    }


def manual_counts_of(counts: Sequence[ManualCountInput]) -> list[ManualCount]:
    """Return what a request holds; raises InvalidInput naming each place."""
    found = []
    for k, count in enumerate(counts):
        try:
            start_us = parse_time_us(count.start)
        except ValueError as error:
            raise InvalidInput.at(f"/{k}/start", str(error)) from None
        if start_us % 60_000_000:
            raise InvalidInput.at(f"/{k}/start", "want a whole minute")
        lane = None if count.lane_id is None else int(count.lane_id.removeprefix("L"))
        group = Group(count.line_id, lane, count.direction, count.length_class)
        found.append(ManualCount(group, start_us, count.interval_s, count.counted))
    return found


def check_fields(checked: Checked) -> Fields:
    """Return the fields of a CheckRow."""
    count, found = checked.count, checked.check
    relative = None if found is None else found.relative_error
    return {
        "line_id": count.group.line_id,
        "lane_id": lane_id(count.group.lane),
        "direction": count.group.direction,
        "length_class": count.group.length_class,
        "start": format_time(count.start_us),
        "end": format_time(count.end_us),
        "interval_s": count.interval_s,
        "coverage": round(checked.coverage, 3),
        "counted": count.counted,
        "measured": None if found is None else found.measured,
        "difference": None if found is None else found.difference,
        "relative_error": None if relative is None else round(relative, 4),
        "geh": None if found is None else round(found.geh, 3),
        "within_target": None if found is None else found.within_target,
    }
