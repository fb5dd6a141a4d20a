"""Turn what traffic analysis gives out into rows and events of the database."""

from __future__ import annotations

from dataclasses import replace

from service.pipeline.blocks import Moment
from service.storage.rows import CellRow, CrossingBlock, LaneChangeRow, MinuteRow, Rows, TrackKey
from service.traffic.model import Outputs
from service.traffic.records import Counts


def traffic_rows(found: Outputs, moment: Moment, events: int) -> tuple[Rows, int]:
    """Return the rows of one step, and how many events the epoch has given out with them."""
    changes = tuple(
        LaneChangeRow(
            key=TrackKey(moment.sensor_id, moment.epoch, change.number),
            time_us=change.time_us,
            decided_us=change.decided_us,
            from_lane=change.from_lane,
            to_lane=change.to_lane,
            x_m=change.x_m,
            y_m=change.y_m,
            speed_mps=change.speed_mps,
            map_version=change.map_version,
        )
        for change in found.changes
    )
    return replace(_count_rows(found.counts, moment), lane_changes=changes), events


def _count_rows(counts: Counts, moment: Moment) -> Rows:
    of, as_of = (moment.sensor_id, moment.epoch), moment.position
    return Rows(
        crossings=tuple(
            CrossingBlock(*of, x.line_id, x.minute, x.part, as_of, x.records.tobytes()) for x in counts.blocks
        ),
        minutes=tuple(
            MinuteRow(*of, x.minute, as_of, x.frames, x.expected, x.observed_us) for x in counts.received
        ),
        cells=tuple(CellRow(*of, x.minute, x.map_version, as_of, x.records.tobytes()) for x in counts.cells),
    )
