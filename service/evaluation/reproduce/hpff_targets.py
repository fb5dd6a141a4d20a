"""The hybrid filter for several targets, which the HPFF paper names as future work: tables of our own."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from service.evaluation.reproduce.form import Bar, Cell, Kind, Settings, Table, mean_and_error
from service.evaluation.reproduce.mast_study import rms_over_runs
from service.evaluation.reproduce.recovery_study import Method, Outcome, Surroundings, repeat
from service.simulation.crossing_vehicles import EASY, SCENES
from service.tracking.recovery import RecoveryParameters

_GUARDED = RecoveryParameters(enabled=True)
METHODS: Mapping[str, Method] = {
    "plain JPDA": Method(),
    "reset at any empty gate": Method(_GUARDED, naive=True),
    "guarded FIR reset": Method(_GUARDED),
    "widening": Method(widen=True),
    "reset and widening": Method(_GUARDED, widen=True),
}
STEPS = len(METHODS) * len(SCENES)
_RUNS_SHARE = 10  # a run of several targets costs as much as many of one
Studied = dict[tuple[str, str], list[Outcome]]


def study(settings: Settings) -> Studied:
    """Return the outcomes of a tenth of the runs, by scene and method."""
    runs, out = max(2, settings.runs // _RUNS_SHARE), {}
    for place, scene in enumerate(SCENES):
        for name, method in METHODS.items():
            out[scene, name] = repeat(scene, method, Surroundings(), runs, (settings.seed, 400 + place))
            settings.advance(f"several targets: {scene}, {name}")
    return out


def table(studied: Studied) -> Table:
    """Return lost tracks, exchanged ones, resets and errors of each scene and method."""
    cells: list[Cell] = []
    for (scene, name), outcomes in studied.items():
        head = f"{scene}, {name}"
        for column, key in (
            ("lost per run", "lost"),
            ("on another vehicle", "switched"),
            ("resets per run", "resets"),
        ):
            if METHODS[name].naive and key == "resets":
                continue  # at every empty gate; not counted
            cells.append(Cell(head, column, None, *mean_and_error([getattr(o, key) for o in outcomes])))
        squared = np.array([o.squared_m2 for o in outcomes])
        held = squared[np.isfinite(squared)]
        value, error = rms_over_runs(held[None]) if held.size else (None, None)
        why = "" if held.size > 1 else f"{held.size} runs that hold a track"
        cells.append(Cell(head, "position error (m)", None, value, error, exact=why))
    runs = len(next(iter(studied.values())))
    note = (
        f"{runs} runs. Two easy scenes (a crossing, an overtaking), two with manoeuvres of 8 m/s^2 (braking "
        "and a lane change among six; right angles), and one made to check the rules (a braking column and "
        "an evasion). sigma_w 2 m/s^2, P_D 0.9, clutter 2e-3 per m^2."
    )
    return Table("Table D", "several targets: JPDA with a FIR reset", Kind.OURS, tuple(cells), note)


def bars(studied: Studied) -> tuple[Bar, ...]:
    """Return lost tracks in easy scenes, elsewhere against plain JPDA, and resets beside another vehicle."""
    found = []
    for scene in SCENES:
        ours = studied[scene, "guarded FIR reset"]
        if scene in EASY:
            found.append(Bar(f"{scene}: lost per run", _mean(ours, "lost"), high=0.02))
            continue
        plain = _mean(studied[scene, "plain JPDA"], "lost")
        share = _mean(ours, "lost") / plain if plain else math.nan
        found.append(Bar(f"{scene}: lost against plain JPDA", share, high=0.15))
        resets = sum(o.resets for o in ours)
        beside = 100.0 * sum(o.beside_another for o in ours) / resets if resets else math.nan
        found.append(Bar(f"{scene}: resets beside another vehicle (%)", beside, high=2.0))
    return tuple(found)


def _mean(outcomes: list[Outcome], key: str) -> float:
    return float(np.mean([getattr(o, key) for o in outcomes]))
