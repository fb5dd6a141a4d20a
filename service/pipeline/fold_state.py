"""The values of the fold: what it remembers of one sensor, what it gives out, and the tracker it needs."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Generic, Protocol, TypeVar

from service.pipeline.blocks import Collected
from service.pipeline.order import Fate, OrderState
from service.storage.rows import Rows
from service.tracking.model import I64, Frame, StepReport, TrackEstimates
from service.tracking.parameters import TrackerParameters
from service.traffic.monitor import TrafficState
from service.traffic.parameters import TrafficSetup


class TrackerState(Protocol):
    """What the fold asks of a tracker's state, a value of frozen dataclasses and arrays."""

    @property
    def idle(self) -> bool:
        """True while there is no track at all, and none that may be listed again."""
        ...

    @property
    def resting_numbers(self) -> I64:
        """Return the numbers of tracks that are not listed now, but may be again, (R,)."""
        ...


MAX_TICKS = 600  # after ten minutes without a frame time jumps, whatever tracks are left

S = TypeVar("S", bound=TrackerState)


class Tracker(Protocol[S]):
    """The tracker as the fold sees it; `service.tracking.tracker` is one."""

    def initial_state(self, parameters: TrackerParameters | None = None) -> S:
        """Return the state before the first frame."""
        ...

    def step(
        self, state: S, frame: Frame, parameters: TrackerParameters
    ) -> tuple[S, TrackEstimates, StepReport]:
        """Return the state and the tracks after one more frame."""
        ...

    def coast(
        self, state: S, time_us: int, parameters: TrackerParameters
    ) -> tuple[S, TrackEstimates, StepReport]:
        """Return the state and the tracks when time passes without a frame."""
        ...


@dataclass(frozen=True, slots=True)
class FoldState(Generic[S]):
    """All that the fold needs to know of a sensor's past."""

    sensor_id: str
    epoch: int
    epoch_first_position: int  # of the first record of the epoch
    position: int  # of the newest folded record
    config: str  # SensorConfig as canonical JSON
    parameters: TrackerParameters  # of that configuration
    setup: TrafficSetup  # likewise
    tracker: S
    traffic: TrafficState
    order: OrderState
    collected: Collected
    frame_us: int | None = None  # time of the newest folded frame
    frame_number: int = 0  # its number
    boot: int = 0  # and its boot
    ticks: int = 0  # since that frame
    events: int = 0  # given out in this epoch

    @property
    def wants_ticks(self) -> bool:
        """True while the passing of time alone would still change something."""
        return bool(self.order.held) or not (self.quiet or self.tired)

    @property
    def quiet(self) -> bool:
        """True when there is no track, no open block, and nothing untold."""
        return (
            self.tracker.idle
            and self.traffic.idle
            and not len(self.collected.tracks.number)
            and not len(self.collected.resting.number)
            and not len(self.collected.blocks.number)
        )

    @property
    def tired(self) -> bool:
        """True after so many ticks in a row that no more are folded."""
        return self.ticks >= MAX_TICKS


@dataclass(frozen=True, slots=True)
class Folded:
    """The tracks after one frame, or after a tick (`frame` is None then)."""

    position: int  # of the record that led to it
    epoch: int
    number: int  # of the newest frame
    boot: int
    time_us: int
    estimates: TrackEstimates
    report: StepReport
    frame: Frame | None  # for its points


@dataclass(frozen=True, slots=True)
class FoldOutput:
    """What one record led to."""

    fate: Fate
    folded: tuple[Folded, ...] = ()  # frames and ticks, in order of time
    rows: Rows = field(default_factory=Rows)
    missing: int = 0  # numbers given up as lost
    dropped: int = 0  # held frames that were found late when their turn came
    restarted: str | None = None  # why the tracker began a new epoch at this record

    @property
    def frames(self) -> tuple[Folded, ...]:
        """The folded frames, without the ticks."""
        return tuple(item for item in self.folded if item.frame is not None)
