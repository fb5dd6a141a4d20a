"""Write an accuracy card: every score of every scene, what it means, and what configuration made it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

from service.evaluation import plots, report
from service.evaluation.meanings import MEANINGS
from service.evaluation.measures import MEASURES, SPEED, Measure, Value, select, with_rates
from service.evaluation.report import Grid

SHOWN = select((
    "hota", "gospa", "gospa_missed", "gospa_false", "switches_per_100", "false_tracks_per_min",
    "count_recall", "count_precision", "latency_median_s", "lateral_rmse_m", "vel_rmse_mps",
))  # fmt: skip
_INTRODUCTION = (
    "Tracks against exact truth. Means over scenes weigh every scene alike; the worst scene is named because "
    "that is what a user on such a road will see. Dashed lines are bars that the product sets itself."
)
_STYLE = """
:root { color-scheme: light dark; --line: #8884; }
body { font: 15px/1.5 system-ui, sans-serif; max-width: 1200px; margin: 2rem auto; padding: 0 1rem; }
h1 { margin-bottom: 0; } dl { display: grid; grid-template-columns: max-content 1fr; gap: 0 1rem; }
dt { font-weight: 600; } dd { margin: 0; }
.wide { overflow-x: auto; } table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { border-bottom: 1px solid var(--line); padding: .2rem .6rem; text-align: right; white-space: nowrap; }
th:first-child, td:first-child, td.text { text-align: left; } td.text { white-space: normal; }
.plots { display: grid; grid-template-columns: repeat(auto-fill, minmax(370px, 1fr)); gap: 1rem; }
.plots svg { width: 100%; height: auto; color: inherit !important; }
""".strip()


@dataclass(frozen=True, slots=True)
class Card:
    """Scores by scene, and what made them."""

    results: Sequence[Mapping[str, Value]]
    about: Mapping[str, object]  # version, digest, profile: name and value

    @property
    def scenes(self) -> list[str]:
        """Return the names of the scenes."""
        return [str(result.get("scene", "-")) for result in self.results]

    @property
    def measures(self) -> list[Measure]:
        """Return the measures that any scene has."""
        full = [with_rates(result) for result in self.results]
        return [m for m in (*MEASURES, *SPEED) if any(math.isfinite(_value(row, m)) for row in full)]

    def values(self, measure: Measure) -> list[float]:
        """Return the score of each scene, NaN where there is none."""
        return [_value(with_rates(result), measure) for result in self.results]


def write(card: Card, folder: Path) -> list[Path]:
    """Write accuracy.md with its pictures, accuracy.html (which needs nothing else) and accuracy.json."""
    (folder / "plots").mkdir(parents=True, exist_ok=True)
    files = {f"plots/{m.key}.svg": picture(card, m) + "\n" for m in SHOWN if m in card.measures}
    files["accuracy.md"] = markdown(card)
    files["accuracy.html"] = html(card)
    files["accuracy.json"] = report.to_json(card.results)
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")
    return [folder / name for name in files]


def markdown(card: Card) -> str:
    """Return the card as Markdown; its pictures are files beside it."""
    about = "".join(f"- {name.replace('_', ' ')}: {value}\n" for name, value in card.about.items())
    pictures = "".join(f"![{m.title}](plots/{m.key}.svg)\n" for m in SHOWN if m in card.measures)
    missed = "".join(f"- {note}\n" for note in report.notes(card.results)) or "None.\n"
    return (
        f"# Accuracy\n\n{_INTRODUCTION}\n\n{about}\n## Scene by scene\n\n"
        f"{report.markdown(report.by_scene(card.results, SHOWN))}\n{pictures}\n"
        f"## All scores\n\n{report.markdown(report.by_measure(card.results, card.measures))}\n"
        f"## Over all scenes\n\n{report.markdown(summary(card))}\n## Missed bars\n\n{missed}\n"
        f"## What the scores mean\n\n{report.markdown(_meanings(card))}"
    )


def html(card: Card) -> str:
    """Return the card as one page that needs no other file."""
    about = "".join(
        f"<dt>{escape(name.replace('_', ' '))}</dt><dd>{escape(str(value))}</dd>"
        for name, value in card.about.items()
    )
    notes = "".join(f"<li>{escape(note)}</li>" for note in report.notes(card.results)) or "<li>None.</li>"
    pictures = "".join(picture(card, measure) for measure in card.measures)
    return (
        "<!doctype html>\n<html lang='en'><meta charset='utf-8'><title>Accuracy of Wayside</title>"
        "<meta name='viewport' content='width=device-width'>"
        f"<style>{_STYLE}</style><h1>Accuracy</h1><p>{escape(_INTRODUCTION)}</p><dl>{about}</dl>"
        f"<h2>Scene by scene</h2>{_table(report.by_scene(card.results, SHOWN))}"
        f"<h2>Pictures</h2><div class='plots'>{pictures}</div>"
        f"<h2>All scores</h2>{_table(report.by_measure(card.results, card.measures))}"
        f"<h2>Over all scenes</h2>{_table(summary(card))}<h2>Missed bars</h2><ul>{notes}</ul>"
        f"<h2>What the scores mean</h2>{_table(_meanings(card), text=True)}</html>\n"
    )


def summary(card: Card) -> Grid:
    """Return mean, best and worst of each measure over the scenes, and which scene is worst."""
    rows = []
    for measure in card.measures:
        known = [
            (v, name) for v, name in zip(card.values(measure), card.scenes, strict=True) if math.isfinite(v)
        ]
        low, high = min(known), max(known)
        best, worst = (high, low) if measure.higher_is_better else (low, high)
        mean = sum(value for value, _ in known) / len(known)
        numbers = (f"{value:.{measure.decimals}f}" for value in (mean, best[0], worst[0]))
        rows.append((measure.title, *numbers, worst[1]))
    return Grid(("measure", "mean", "best", "worst", "worst scene"), tuple(rows))


def picture(card: Card, measure: Measure) -> str:
    """Return the scores of one measure as bars."""
    arrow = "more is better" if measure.higher_is_better else "less is better"
    title = f"{measure.title} ({arrow})"
    return plots.bars(title, card.scenes, card.values(measure), decimals=measure.decimals, bar=measure.floor)


def _meanings(card: Card) -> Grid:
    rows = tuple((m.title, MEANINGS[m.key]) for m in card.measures)
    return Grid(("measure", "what it says"), rows)


def _table(grid: Grid, *, text: bool = False) -> str:
    kind = " class='text'" if text else ""
    heads = "".join(f"<th>{escape(head)}</th>" for head in grid.heads)
    rows = "".join(
        f"<tr>{''.join(f'<td{kind}>{escape(cell)}</td>' for cell in row)}</tr>" for row in grid.rows
    )
    return f"<div class='wide'><table><thead><tr>{heads}</tr></thead><tbody>{rows}</tbody></table></div>"


def _value(result: Mapping[str, Value], measure: Measure) -> float:
    value = result.get(measure.key)
    return float(value) if isinstance(value, int | float) else math.nan
