"""Draw the figures of a reproduction as PNG files; matplotlib comes with the extra `plots`."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import TYPE_CHECKING

from service.evaluation.reproduce.form import Figure, Panel, Reproduction

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_COLUMNS = 2
_PANEL_INCHES = (5.5, 3.6)
_DPI = 110


def can_draw() -> bool:
    """Tell whether matplotlib is installed."""
    return importlib.util.find_spec("matplotlib") is not None


def file_names(result: Reproduction) -> dict[str, str]:
    """Return the file name of each figure that has something to draw, by its number."""
    drawn = [f.number for f in result.figures if f.panels]
    return {number: f"{result.paper}-{number.lower().replace(' ', '-')}.png" for number in drawn}


def draw(result: Reproduction, folder: Path) -> None:
    """Write a file for each figure with panels."""
    names = file_names(result)
    for figure in result.figures:
        if figure.number in names:
            _draw_figure(figure, folder / names[figure.number])


def _draw_figure(figure: Figure, path: Path) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415 - an extra, and slow to import
    from matplotlib.figure import Figure as Sheet  # noqa: PLC0415

    columns = min(_COLUMNS, len(figure.panels))
    rows = -(-len(figure.panels) // columns)
    sheet = Sheet(figsize=(_PANEL_INCHES[0] * columns, _PANEL_INCHES[1] * rows), layout="constrained")
    FigureCanvasAgg(sheet)
    sheet.suptitle(f"{figure.number}: {figure.title}", fontsize=10)
    for place, panel in enumerate(figure.panels):
        _draw_panel(sheet.add_subplot(rows, columns, place + 1), panel)
    sheet.savefig(path, dpi=_DPI, metadata={"Software": None})


def _draw_panel(axes: Axes, panel: Panel) -> None:
    for line in panel.lines:
        style = "." if line.dots else "-"
        axes.plot(line.x, line.y, style, label=line.name, markersize=2.5, linewidth=1.0)
    axes.set_title(panel.title, fontsize=9)
    axes.set_xlabel(panel.x_label, fontsize=8)
    axes.set_ylabel(panel.y_label, fontsize=8)
    axes.grid(visible=True, linewidth=0.3)
    axes.legend(fontsize=7)
