"""`wayside chaos`: cut the service's power a hundred times, and prove that nothing is lost or doubled."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Annotated

import typer

from service.cli import options
from service.cli.edge import FAILED, one_sentence, say
from service.cli.output import print_json, print_rows, progress, provenance

if TYPE_CHECKING:
    from service.chaos.incidents import Incident
    from service.chaos.suite import Outcome, Reference, Suite


@one_sentence()
def chaos(
    *,
    cuts: Annotated[int, typer.Option(min=0, max=10_000, help="How many cuts are made.")] = 100,
    seed: Annotated[int, typer.Option(min=0, help="Equal seeds give equal cuts.")] = 1,
    frames: Annotated[int, typer.Option(min=48, max=5_000, help="Of each of two radars in one run.")] = 160,
    incidents: Annotated[
        bool, typer.Option("--incidents/--no-incidents", help="Also full disk, damaged files, signals.")
    ] = True,
    show: options.ShowProgress = None,
    as_json: options.Json = False,
) -> None:
    """Kill a host at seeded moments, cut its power, fill its disk, damage its files; compare what is stored.

    Every third cut is made where trackers are processes, and ends all of them or one tracker alone. Works in
    temporary folders and on the loopback only, and touches no service that runs. Exit code 1 when a run does
    not end as an uninterrupted one.
    """
    import logging

    import structlog

    from service import warmup
    from service.chaos.suite import Suite

    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))
    warmup.warm_up(lambda _name, _seconds: None)  # once, for all the processes that are forked from here
    suite = Suite(seed, frames)
    with progress(wanted=show) as bar:
        task = bar.add_task("uninterrupted run", total=cuts + 1)
        reference = suite.reference()
        bar.advance(task)
        outcomes = []
        for plan in suite.plans(cuts, reference):
            bar.update(task, description=plan.phase.value)
            outcomes.append(suite.cut(plan, reference))
            bar.advance(task)
        found = _incidents(suite, reference) if incidents else []
    if not reference.watched:
        say("This Python has SQLite built in: no power was cut and no disk was full, only kill -9 was tried.")
    if as_json:
        print_json(_record(suite, reference, outcomes, found))
    else:
        _print(outcomes, found)
    if not all([o.sound for o in outcomes] + [i.sound for i in found]):
        raise typer.Exit(FAILED)


def _incidents(suite: Suite, reference: Reference) -> list[Incident]:
    from service.chaos.incidents import incidents

    return list(incidents(reference, suite.folder))


def _print(outcomes: list[Outcome], found: list[Incident]) -> None:
    if outcomes:
        rows = [
            {"what": phase, "how": kind, "cuts": count, "equal": _sound(outcomes, phase, kind)}
            for (phase, kind), count in sorted(Counter((o.plan.phase, o.plan.kind) for o in outcomes).items())
        ]
        equal = sum(outcome.sound for outcome in outcomes)
        title = f"{equal} of {len(outcomes)} cuts end with rows, states and answers of the uninterrupted run"
        print_rows(("what", "how", "cuts", "equal"), rows, title=title)
    if found:
        rows = [{"fault": i.name, "wanted": i.wanted, "went so": i.sound} for i in found]
        print_rows(("fault", "wanted", "went so"), rows, title="other faults")
    for outcome in outcomes:
        for difference in outcome.differences:
            say(f"{outcome.plan}: {difference}")
    for incident in found:
        for fault in incident.faults:
            say(f"{incident.name}: {fault}")


def _sound(outcomes: list[Outcome], phase: str, kind: str) -> int:
    return sum(o.sound for o in outcomes if o.plan.phase == phase and o.plan.kind == kind)


def _record(
    suite: Suite, reference: Reference, outcomes: list[Outcome], found: list[Incident]
) -> dict[str, object]:
    return {
        **provenance(),
        "seed": suite.seed,
        "frames": 2 * suite.frames,
        "batches": len(reference.work),
        "rows": {str(name): len(rows) for name, rows in reference.evidence.rows.items()},
        "below_sqlite": reference.watched,
        "cuts": len(outcomes),
        "equal": sum(outcome.sound for outcome in outcomes),
        "durable_before_heard": sum(outcome.durable_unheard for outcome in outcomes),
        "runs": [
            {
                "phase": o.plan.phase,
                "kind": o.plan.kind,
                "tracker_processes": o.plan.processes,
                "occurrence": o.plan.occurrence,
                "delay": o.plan.delay,
                "acknowledged": o.acknowledged,
                "differences": o.differences,
            }
            for o in outcomes
        ],
        "incidents": [{"name": i.name, "wanted": i.wanted, "faults": i.faults} for i in found],
    }
