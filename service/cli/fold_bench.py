"""Time what the fold adds to the tracker's steps: order, rows, traffic; and the traffic of it by itself."""

from __future__ import annotations

from dataclasses import replace

from service.evaluation.bench import Clock, Watched
from service.formats.sensor import SensorConfig
from service.pipeline import fold
from service.pipeline.fold_state import Folded, FoldState
from service.pipeline.records import FrameRecord
from service.tracking import tracker
from service.tracking.model import Frame
from service.tracking.parameters import TrackerParameters
from service.tracking.state import TrackerState
from service.traffic import monitor
from service.traffic.model import Moment


class FoldRun:
    """The whole fold under one load, and what each of its steps took beside the tracker's."""

    def __init__(self, frames: list[Frame], parameters: TrackerParameters, clock: Clock) -> None:
        self._frames = frames
        self._engine = Watched(clock)
        begun = fold.start("radar-1", 1, SensorConfig(), self._engine)
        state = tracker.initial_state(parameters)
        self._state: FoldState[TrackerState] = replace(begun, parameters=parameters, tracker=state)
        self._traffic = monitor.initial_state()
        self.added_s: list[float] = []
        self.traffic_s: list[float] = []

    def advance(self, begin: int, end: int) -> None:
        """Take the steps of the frames begin:end."""
        for frame in self._frames[begin:end]:
            record = FrameRecord(frame, frame.time_us)
            before = self._engine.clock()
            self._state, out = fold.step(self._state, self._state.position + 1, record, self._engine)
            self.added_s.append(self._engine.clock() - before - sum(self._engine.spent_s.values()))
            self.traffic_s.append(self._analyse(out.folded[-1]))

    def _analyse(self, folded: Folded) -> float:
        """Analyse the traffic of a frame once more, as the fold did, and return the seconds that it took."""
        moment = Moment(folded.time_us, folded.number, tick=False)
        before = self._engine.clock()
        self._traffic, _, _ = monitor.step(self._traffic, moment, folded.estimates, self._state.setup)
        return self._engine.clock() - before
