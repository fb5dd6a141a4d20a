"""Draw scores as bars in SVG: one small picture a measure, one bar a scene, readable in light and dark."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape

WIDTH, ROW, TOP, LABEL, VALUE = 360, 20, 26, 120, 56  # pixels
_INK = "font-family='system-ui, sans-serif' font-size='12' fill='currentColor'"


def bars(
    title: str, names: Sequence[str], values: Sequence[float], *, decimals: int, bar: float | None = None
) -> str:
    """Return a picture with a horizontal bar for each name; NaN leaves it out, `bar` draws a line to reach.

    Bars begin at zero, to the left of it where values are negative.
    """
    known = [value for value in (*values, bar) if value is not None and math.isfinite(value)]
    low, high = min([0.0, *known]), max([0.0, *known])
    scale = (WIDTH - LABEL - VALUE) / ((high - low) or 1.0)

    def place(value: float) -> float:
        return LABEL + (value - low) * scale

    height = TOP + ROW * len(names) + 4
    label = escape(title, quote=True)
    head = (
        f"<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 {WIDTH} {height}' width='{WIDTH}' "
        f"height='{height}' role='img' aria-label='{label}' color='#456'>"
        f"<text x='0' y='15' font-weight='600' {_INK}>{escape(title)}</text>"
    )
    parts = [head]
    for row, (name, value) in enumerate(zip(names, values, strict=True)):
        y = TOP + ROW * row
        parts.append(f"<text x='0' y='{y + 13}' {_INK}>{escape(_short(name))}</text>")
        if not math.isfinite(value):
            parts.append(f"<text x='{LABEL}' y='{y + 13}' {_INK}>-</text>")
            continue
        left, right = sorted((place(0.0), place(value)))
        parts.append(
            f"<rect x='{left:.1f}' y='{y + 2}' width='{max(right - left, 0.5):.1f}' height='{ROW - 6}' "
            f"rx='2' fill='#3b82c4'/>"
            f"<text x='{right + 4:.1f}' y='{y + 13}' {_INK}>{value:.{decimals}f}</text>"
        )
    if bar is not None:
        x = f"{place(bar):.1f}"
        parts.append(f"<path d='M{x} {TOP - 3}V{height - 3}' stroke='#c2410c' stroke-dasharray='3 2'/>")
    return "".join([*parts, "</svg>"])


def _short(name: str, letters: int = 17) -> str:
    return name if len(name) <= letters else f"{name[: letters - 1]}…"
