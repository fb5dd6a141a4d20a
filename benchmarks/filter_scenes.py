"""Track recorded scenes with every filter, and put accuracy, velocity error and time into the page.

    python -m benchmarks.filter_scenes SCENE_DIR... [--jobs N] [--until S] [--filters NAME,...]
        [--json docs/measured/filter_scenes.json] [--page docs/papers.md]
    python -m benchmarks.filter_scenes --from docs/measured/filter_scenes.json --page docs/papers.md

The tables replace what stands between the two marks in the page. What is measured is that of `wayside
compare`; times are of the processor, and true where nothing else runs. Each scene and filter is a job of
its own. `--from` draws the tables of results measured before.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")  # before numpy is imported
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.commit import commit  # noqa: E402
from service.evaluation.compare import compare  # noqa: E402
from service.evaluation.measures import Value  # noqa: E402
from service.evaluation.report import Grid, markdown  # noqa: E402
from service.tracking.filters.registry import filter_names  # noqa: E402

Rows = Sequence[Mapping[str, Value]]

BEGIN, END = "<!-- filters on the scenes: begin -->", "<!-- filters on the scenes: end -->"
MEAN = "mean"
TABLES = (  # title, key, decimals, +1 where more is better
    ("HOTA", "hota", 3, 1),
    ("GOSPA, m", "gospa", 2, -1),
    ("Velocity error, m/s", "vel_rmse_mps", 2, -1),
    ("Time of the filter, microseconds of processor for a track and step", "filter_us", 0, -1),
)
SITES = {  # kind of site: the scenes that show it, by name
    "free-flowing roads": ("free_flow", "dense", "two_way", "wide"),
    "queues and signals": ("stop_and_go",),
    "intersections": ("intersection",),
    "curves": ("curve",),
}
ALIKE_HOTA = 0.01  # less is noise


def measure(until_s: float | None, job: tuple[Path, str]) -> dict[str, Value]:
    """Return the scores of one filter on one scene, with the processor's seconds that it took."""
    scene, name = job
    begin = time.process_time()
    found = compare(
        [scene], [name], settings={}, until=until_s, clock=time.process_time, advance=lambda _: None
    )
    return {**found[0], "cpu_s": time.process_time() - begin}


def measure_all(
    scenes: Sequence[Path], names: Sequence[str], until_s: float | None, processes: int
) -> list[dict[str, Value]]:
    """Return the scores of all filters on all scenes, scene by scene."""
    jobs = [(scene, name) for scene in scenes for name in names]
    context, results = multiprocessing.get_context("spawn"), []
    with ProcessPoolExecutor(processes, mp_context=context) as pool:
        for result in pool.map(partial(measure, until_s), jobs):
            results.append(result)
            said = (
                f"{result['scene']}, {result['filter']}: HOTA {result['hota']:.3f}, {result['cpu_s']:.0f} s"
            )
            print(f"{len(results)}/{len(jobs)} {said}", flush=True)
    return results


def page(rows: Rows, until_s: float | None) -> str:
    """Return the tables and the recommendations as Markdown."""
    scenes = list(dict.fromkeys(str(row["scene"]) for row in rows))
    span = "whole" if until_s is None else f"first {until_s:g} s of the"
    parts = [f"The {span} scenes; the best of each is bold.\n"]
    for title, key, decimals, sign in TABLES:
        parts.append(f"{title}:\n\n{markdown(_grid(rows, scenes, key, decimals, sign))}")
    parts.append(f"Which filter for which kind of site, by these numbers:\n\n{markdown(advice(rows))}")
    return "\n".join(parts)


def _grid(rows: Rows, scenes: Sequence[str], key: str, decimals: int, sign: int) -> Grid:
    best = {s: max(sign * round(float(r[key]), decimals) for r in rows if r["scene"] == s) for s in scenes}

    def cell(scene: str, value: float) -> str:
        text = f"{value:.{decimals}f}"
        return f"**{text}**" if sign * round(value, decimals) == best[scene] and key != "filter_us" else text

    lines = []
    for name in ranked(rows):
        own = {str(r["scene"]): float(r[key]) for r in rows if r["filter"] == name}
        average = sum(own.values()) / len(own)
        lines.append((f"`{name}`", *(cell(s, own[s]) for s in scenes), f"{average:.{decimals}f}"))
    return Grid(("filter", *(s.replace("_", " ") for s in scenes), MEAN), tuple(lines))


def ranked(rows: Rows) -> list[str]:
    """Return the names of the filters, the one of the greatest mean HOTA first."""
    return sorted({str(r["filter"]) for r in rows}, key=lambda n: (-_mean(rows, n, "hota"), n))


def _mean(rows: Rows, name: str, key: str, scenes: Sequence[str] | None = None) -> float:
    own = [float(r[key]) for r in rows if r["filter"] == name and (scenes is None or r["scene"] in scenes)]
    return sum(own) / len(own)


def advice(rows: Rows) -> Grid:
    """Return for each kind of site the filters of the greatest HOTA, and those that are as good.

    A filter is as good as the best where its mean HOTA is within `ALIKE_HOTA`.
    """
    heads = ("kind of site", "greatest HOTA", "second", "as good, least velocity error", "as good, cheapest")
    known, lines = {str(r["scene"]) for r in rows}, []
    for site, wanted in SITES.items():
        scenes = [s for s in wanted if s in known]
        if not scenes:
            continue
        mean: Callable[[str, str], float] = lambda n, key, here=scenes: _mean(rows, n, key, here)  # noqa: E731
        order = sorted(ranked(rows), key=lambda n: -mean(n, "hota"))
        alike = [n for n in order if mean(n, "hota") >= mean(order[0], "hota") - ALIKE_HOTA]
        surest = min(alike, key=lambda n: mean(n, "vel_rmse_mps"))
        cheapest = min(alike, key=lambda n: mean(n, "filter_us"))
        first = f"`{order[0]}` {mean(order[0], 'hota'):.3f}"
        second = f"`{order[1]}` {mean(order[1], 'hota'):.3f}" if len(order) > 1 else "-"
        speed = f"`{surest}` {mean(surest, 'vel_rmse_mps'):.2f} m/s"
        lines.append((site, first, second, speed, f"`{cheapest}` {mean(cheapest, 'filter_us'):.0f} us"))
    return Grid(heads, tuple(lines))


def put(path: Path, text: str) -> None:
    """Replace what stands between the marks of the page."""
    whole = path.read_text()
    if whole.count(BEGIN) != 1 or whole.count(END) != 1 or whole.index(BEGIN) > whole.index(END):
        raise SystemExit(f"{path}: want {BEGIN} and after it {END}, once each")
    before, rest = whole.split(BEGIN)
    path.write_text(f"{before}{BEGIN}\n\n{text}\n{END}{rest.split(END)[1]}")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scenes", nargs="*", type=Path, metavar="SCENE_DIR")
    parser.add_argument("--jobs", type=int, default=1, help="processes; times are true with one")
    parser.add_argument("--until", type=float, metavar="S", help="only the first so many seconds")
    parser.add_argument("--filters", default=",".join(filter_names()), metavar="NAME,...")
    parser.add_argument("--json", type=Path, help="write all scores here")
    parser.add_argument(
        "--from", type=Path, dest="measured", help="scores written by --json; measure nothing"
    )
    parser.add_argument("--page", type=Path, help="write the tables between the marks of this page")
    options = parser.parse_args()
    if bool(options.scenes) == bool(options.measured):
        parser.error("name scenes to measure, or --from with what was measured")
    if options.measured:
        content = json.loads(options.measured.read_text())
    else:
        results = measure_all(options.scenes, options.filters.split(","), options.until, options.jobs)
        content = {"commit": commit(), "until_s": options.until, "results": results}
    if options.json:
        options.json.write_text(json.dumps(content, indent=1) + "\n")
    text = page(content["results"], content["until_s"])
    if options.page:
        put(options.page, text)
    else:
        print(text)


if __name__ == "__main__":
    main()
