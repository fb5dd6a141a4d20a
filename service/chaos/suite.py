"""Cut a host at many seeded moments, let it go on, and compare what it stored with an uninterrupted run."""

from __future__ import annotations

import random
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from service.chaos import child, process
from service.chaos.cut import Kind, Phase, Plan
from service.chaos.evidence import Evidence, gather
from service.chaos.process import FAILED, Ended
from service.chaos.workload import Batch, batches
from service.errors import StorageError

FRAMES = 160  # of each radar in one run
TRIES = 5  # to reach the moment of a plan: how often rows are flushed depends on the machine

_ROUND = (  # every phase comes up in ten cuts
    Phase.BATCH, Phase.FLUSH, Phase.SNAPSHOT, Phase.SEGMENT, Phase.MIGRATION, Phase.OPENING, Phase.REPLY,
    Phase.ANY, Phase.DROP, Phase.BATCH,
)  # fmt: skip
_PROCESS_ROUND = (  # of the cuts where trackers are processes
    Phase.FLUSH, Phase.BATCH, Phase.SNAPSHOT, Phase.ANY, Phase.OPENING, Phase.REPLY, Phase.SEGMENT,
    Phase.DROP,
)  # fmt: skip
_PROCESS_SHARE = 3  # every third cut
_KINDS = (Kind.KILL, Kind.KILL, Kind.POWER, Kind.POWER, Kind.TORN)
_LONGEST_DELAY = 9  # a commit is one to eight operations on the disk
_OPENING_OPERATIONS = 60  # that a recovery has at least


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of one run that was cut."""

    plan: Plan
    acknowledged: int  # batches before the cut
    durable_unheard: bool  # the batch under way was in the log, and its sender had not heard so
    differences: tuple[str, ...]

    @property
    def sound(self) -> bool:
        """Whether the run ended as if it had not been cut."""
        return not self.differences


@dataclass(frozen=True, slots=True)
class Reference:
    """The uninterrupted run."""

    work: list[Batch]
    evidence: Evidence
    outcomes: list[list[str]]
    seen: dict[str, int]  # how often each phase came up
    watched: bool = True  # the layer below SQLite is there, so power cuts can be made


@dataclass(slots=True)
class Suite:
    """The runs of one seed."""

    seed: int
    frames: int = FRAMES
    folder: Path = field(default_factory=lambda: Path(tempfile.gettempdir()))
    tell: Callable[[str], None] = lambda _: None

    def reference(self) -> Reference:
        """Run without a cut."""
        work = batches(self.frames, self.seed)
        with tempfile.TemporaryDirectory(dir=self.folder, prefix="wayside-chaos-") as name:
            ended = run(Path(name), work, 0)
            _require_end(ended)
            *said, last = ended.said
            seen = last["seen"]
            assert isinstance(seen, dict)  # noqa: S101 - our own message
            return Reference(work, gather(Path(name)), _outcomes(said), seen, bool(last["watched"]))

    def plans(self, count: int, reference: Reference) -> list[Plan]:
        """Return the moments of the cuts; equal seeds give equal plans for equal counts of the reference."""
        rng = random.Random(self.seed)  # noqa: S311 - no secret
        made: list[Plan] = []
        for index in range(count):
            turn, rest = divmod(index, _PROCESS_SHARE)
            in_processes = rest == _PROCESS_SHARE - 1
            phase = (
                _PROCESS_ROUND[turn % len(_PROCESS_ROUND)]
                if in_processes
                else _ROUND[(index - turn) % len(_ROUND)]
            )
            often = reference.seen.get(Phase.ANY if phase is Phase.OPENING else phase, 0)
            if not often:  # a short run drops nothing
                phase, often = Phase.BATCH, reference.seen[Phase.BATCH]
            plan = Plan(
                phase,
                rng.randint(1, max(1, 4 * often // 5)),
                rng.randint(-1, _LONGEST_DELAY) if reference.watched else -1,
                rng.choice(_KINDS) if reference.watched else Kind.KILL,
                rng.getrandbits(32),
            )
            if in_processes:
                kind = rng.choice((Kind.GROUP, Kind.TRACKER))
                plan = replace(plan, kind=kind, processes=rng.randint(1, 2))
            made.append(plan)
        return made

    def cut(self, plan: Plan, reference: Reference) -> Outcome:
        """Carry out one plan."""
        for _ in range(TRIES):
            with tempfile.TemporaryDirectory(dir=self.folder, prefix="wayside-chaos-") as name:
                outcome = _cut(Path(name), plan, reference)
            if outcome is not None:
                return outcome
            plan = replace(plan, occurrence=max(1, plan.occurrence // 2), delay=min(plan.delay, 0))
        raise StorageError(f"the moment of {plan} never came")


def _cut(data_dir: Path, plan: Plan, reference: Reference) -> Outcome | None:
    """Return what became of the run, None when it ended before the moment of its cut."""
    first_plan = plan
    if plan.phase is Phase.OPENING:
        first_plan = replace(plan, phase=Phase.ANY, kind=Kind.GROUP if plan.processes else plan.kind)
    ended = run(data_dir, reference.work, 0, first_plan)
    if not ended.killed:
        _require_end(ended)
        if not ended.said[-1]["cut"]:
            return None
    said = [message for message in ended.said if "batch" in message]
    cuts = [len(said)]  # batches acknowledged before each
    if plan.phase is Phase.OPENING:  # cut once more while the first cut is recovered from
        again = replace(plan, occurrence=1 + plan.seed % _OPENING_OPERATIONS, delay=0)
        ended = run(data_dir, reference.work, len(said), again)
        if not ended.killed:
            _require_end(ended)
        said = said + [message for message in ended.said if "batch" in message]
        cuts.append(len(said))
    acknowledged = len(said)
    ended = run(data_dir, reference.work, acknowledged, processes=plan.processes)
    _require_end(ended)
    outcomes = _outcomes([*said, *ended.said[:-1]])
    differences = gather(data_dir).differences(reference.evidence)
    unheard = [cut for cut in cuts if cut < len(outcomes) and set(outcomes[cut]) == {"duplicate"}]
    for cut in unheard:
        outcomes[cut] = reference.outcomes[cut]
    if outcomes != reference.outcomes:
        wrong = [n for n, (a, b) in enumerate(zip(outcomes, reference.outcomes, strict=True)) if a != b]
        differences.append(f"other answers to the batches {wrong[:5]}")
    return Outcome(plan, acknowledged, bool(unheard), tuple(differences))


def run(
    data_dir: Path, work: Sequence[Batch], first: int, plan: Plan | None = None, *, processes: int = 0
) -> Ended:
    """Post what is left of the work in a process of its own; `processes` track, or those of the plan."""
    if plan is not None:
        processes = plan.processes
    return process.start(
        lambda say: child.post(say, data_dir, work, first, plan=plan, processes=processes)
    ).end()


def _outcomes(said: Sequence[dict[str, object]]) -> list[list[str]]:
    return [[str(item) for item in outcome] for m in said if isinstance(outcome := m["outcomes"], list)]


def _require_end(ended: Ended) -> None:
    if ended.code or ended.signal is not None:
        reason = "it raised an error" if ended.code == FAILED else f"signal {ended.signal}"
        raise StorageError(f"a process of the run failed by itself ({reason}); its traceback is above")
