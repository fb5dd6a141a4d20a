"""The kinds of record in a sensor's log: three that are written, and what is read where one was damaged."""

from __future__ import annotations

from dataclasses import dataclass, field

from service.tracking.model import Frame


@dataclass(frozen=True, slots=True)
class FrameRecord:
    """One accepted frame; `late` and duplicate frames are logged too, the fold decides by log order."""

    frame: Frame
    received_us: int  # host time at the door; evidence only, the fold never uses it
    encoded: bytes | None = field(default=None, compare=False, repr=False)  # the frame's, where made already


@dataclass(frozen=True, slots=True)
class ControlRecord:
    """A change of the sensor's configuration that takes effect between two frames.

    `config` is the whole new configuration as canonical JSON (formats.sensor.SensorConfig).
    """

    config: str
    received_us: int


@dataclass(frozen=True, slots=True)
class TickRecord:
    """Time goes on without frames: last frame time + 1 s, + 2 s, ...

    Ticks coast and end tracks, close state blocks and flush the reorder buffer.
    """

    time_us: int


@dataclass(frozen=True, slots=True)
class DamagedRecord:
    """A record whose bytes cannot be read any more, or one that must not be folded; never written.

    fatal: the tracker's process died over it again and again. That may be the fault of a frame which was held
    back until then, so those are left out as well.
    """

    reason: str
    fatal: bool = False


Record = FrameRecord | ControlRecord | TickRecord | DamagedRecord
