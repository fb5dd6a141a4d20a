"""Draw a comparison of filters: velocity error and HOTA of each, a dot for each recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from service.evaluation.compare import MEAN, with_means
from service.evaluation.measures import Value

SHOWN = (("vel_rmse_mps", "velocity error, m/s"), ("pos_rmse_m", "position error, m"), ("hota", "HOTA"))
_INCHES = (4.2, 0.35)  # width of a panel, height of a filter


def draw(results: Sequence[Mapping[str, Value]], path: Path) -> None:
    """Write the plot, in the format of the path's ending; matplotlib comes with the extra `plots`."""
    from matplotlib import rc_context  # noqa: PLC0415 - an extra, and slow to import
    from matplotlib.figure import Figure  # noqa: PLC0415

    rows = with_means(results)
    names = list(dict.fromkeys(str(row["filter"]) for row in rows))
    scenes = [scene for scene in dict.fromkeys(str(row["scene"]) for row in rows) if scene != MEAN]
    sheet = Figure(figsize=(_INCHES[0] * len(SHOWN), 1.4 + _INCHES[1] * len(names)), layout="constrained")
    panels = sheet.subplots(1, len(SHOWN), sharey=True)
    for axes, (key, title) in zip(panels, SHOWN, strict=True):
        for scene in [*scenes, MEAN]:
            own = {str(row["filter"]): float(row[key]) for row in rows if row["scene"] == scene}
            if own:
                style = (
                    {"marker": "|", "s": 160, "color": "black"} if scene == MEAN else {"marker": "o", "s": 22}
                )
                axes.scatter(list(own.values()), [names.index(name) for name in own], label=scene, **style)
        axes.set_yticks(range(len(names)), names)
        axes.invert_yaxis() if axes is panels[0] else None
        axes.set_xlabel(title, fontsize=9)
        axes.grid(visible=True, linewidth=0.3)
    panels[-1].legend(fontsize=7, loc="best")
    with rc_context({"svg.hashsalt": "wayside", "svg.fonttype": "none"}):  # equal results give equal files
        sheet.savefig(path, metadata={"Date": None} if path.suffix == ".svg" else None)
