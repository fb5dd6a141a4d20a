"""Turn what traffic analysis gives out into rows and events of the database."""

from __future__ import annotations

from service.pipeline.blocks import Moment
from service.storage.rows import LaneChangeRow, Rows, TrackKey
from service.traffic.model import Outputs


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
    return Rows(lane_changes=changes), events
