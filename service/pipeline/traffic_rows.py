"""Turn what traffic analysis gives out into rows and events of the database."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from service.formats.lanes import LaneRecord, lanes_json, rounded_points
from service.pipeline.blocks import Moment
from service.storage.rows import (
    CellRow,
    CrossingBlock,
    EventRow,
    LaneChangeRow,
    LaneMapRow,
    MinuteRow,
    Rows,
    TrackKey,
)
from service.traffic.model import Lane, LaneChange, LaneDrift, LaneMap, Outputs
from service.traffic.records import Counts

DRIFT_OPENED = "lane_map_drift"
DRIFT_CLOSED = "lane_map_drift_over"


def traffic_rows(found: Outputs, moment: Moment, events: int) -> tuple[Rows, int]:
    """Return the rows of one step, and how many events the epoch has given out with them."""
    told: tuple[EventRow, ...] = ()
    if found.drift is not None:
        events += 1
        told = (_drift_event(found.drift, moment, events),)
    rows = replace(
        _count_rows(found.counts, moment),
        events=told,
        lane_changes=tuple(_change_row(change, moment) for change in found.changes),
        lane_maps=() if found.map is None else (map_row(found.map, moment.sensor_id, moment.epoch),),
    )
    return rows, events


def map_row(lane_map: LaneMap, sensor_id: str, epoch: int) -> LaneMapRow:
    """Return a lane map as a row."""
    return LaneMapRow(
        sensor_id=sensor_id,
        epoch=epoch,
        version=lane_map.version,
        time_us=lane_map.time_us,
        frame=lane_map.frame,
        vehicles=lane_map.vehicles,
        source=lane_map.source,
        lanes=lanes_json(lane_record(lane) for lane in lane_map.lanes),
    )


def lane_record(lane: Lane) -> LaneRecord:
    """Return a lane as plain values, in centimetres."""
    return LaneRecord(
        index=lane.index,
        lane_id=lane.lane_id,
        kind=lane.kind,
        direction=lane.direction,
        points_m=rounded_points(lane.points_m),
        width_m=tuple(np.round(lane.width_m, 2).tolist()),
        confidence=lane.confidence,
        vehicles=lane.vehicles,
    )


def _change_row(change: LaneChange, moment: Moment) -> LaneChangeRow:
    return LaneChangeRow(
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


def _drift_event(drift: LaneDrift, moment: Moment, number: int) -> EventRow:
    return EventRow(
        sensor_id=moment.sensor_id,
        epoch=moment.epoch,
        number=number,
        as_of=moment.position,
        kind=DRIFT_OPENED if drift.opened else DRIFT_CLOSED,
        time_us=moment.time_us,
        detail={
            "share_outside": round(drift.share, 3),
            "vehicles": drift.vehicles,
            "map_version": drift.map_version,
        },
    )


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
