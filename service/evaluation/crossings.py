"""Find where tracks cross the count lines, and score crossings against the true ones."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from service.evaluation.polyline import feet
from service.evaluation.recorded import FoundCrossing, RecordedTracks, TrackId
from service.evaluation.rules import ScoringRules
from service.evaluation.truth import Scene, TruthCrossing
from service.formats.sensor import CountLine
from service.tracking.model import F64, I64

_PARALLEL = 1e-9  # cross product below which step and line are parallel, m^2
_NO_PAIR = 100.0  # cost of crossings too far apart in time


@dataclass(frozen=True, slots=True)
class Event:
    """A found crossing with its lane named as in the truth."""

    t_s: float
    lane_id: TrackId | None
    speed_mps: float


def crossings_of(scene: Scene, tracks: RecordedTracks, rules: ScoringRules) -> list[FoundCrossing]:
    """Return the crossings of the tracks: each track crosses each line at most once in each direction."""
    before, after = _steps(scene, tracks, rules.crossing_gap_s)
    hits = [_hits(line, tracks, before, after) for line in scene.site.count_lines]
    rank = sorted((int(after[k]), n, k) for n, (which, _, _) in enumerate(hits) for k in which)
    frame = np.repeat(np.arange(len(scene.time_s)), np.diff(tracks.start))
    out: list[FoundCrossing] = []
    done: set[tuple[int, int, bool]] = set()
    for s, n, k in rank:
        _, share, leftward = hits[n]
        key = (int(tracks.track[s]), n, bool(leftward[k]))
        if key in done:
            continue
        done.add(key)
        o, u = before[k], float(share[k])
        t0, t1 = scene.time_s[frame[o]], scene.time_s[frame[s]]
        out.append(
            FoundCrossing(
                line_id=scene.site.count_lines[n].line_id,
                t_s=float(t0 + u * (t1 - t0)) - scene.origin_s,
                lane_id=None,
                x_m=float(tracks.x_m[o] + u * (tracks.x_m[s] - tracks.x_m[o])),
                y_m=float(tracks.y_m[o] + u * (tracks.y_m[s] - tracks.y_m[o])),
                speed_mps=math.hypot(tracks.vx_mps[s], tracks.vy_mps[s]),
            )
        )
    return out


def _steps(scene: Scene, tracks: RecordedTracks, gap_s: float) -> tuple[I64, I64]:
    """Return the rows before and after each step of a track from one of its frames to its next."""
    frame = np.repeat(np.arange(len(scene.time_s)), np.diff(tracks.start))
    order = np.lexsort((frame, tracks.track))
    before, after = order[:-1], order[1:]
    good = tracks.track[before] == tracks.track[after]
    good &= scene.time_s[frame[after]] - scene.time_s[frame[before]] < gap_s
    return before[good], after[good]


def _hits(line: CountLine, tracks: RecordedTracks, before: I64, after: I64) -> tuple[list[int], F64, F64]:
    """Return which steps cross the line, and for all steps the share of the way and the side they go to."""
    ex, ey = line.p1[0] - line.p0[0], line.p1[1] - line.p0[1]
    dx, dy = tracks.x_m[after] - tracks.x_m[before], tracks.y_m[after] - tracks.y_m[before]
    ox, oy = line.p0[0] - tracks.x_m[before], line.p0[1] - tracks.y_m[before]
    cross = dx * ey - dy * ex
    safe = np.where(np.abs(cross) < _PARALLEL, np.nan, cross)
    along_step, along_line = (ox * ey - oy * ex) / safe, (ox * dy - oy * dx) / safe
    inside = (along_step >= 0) & (along_step < 1) & (along_line >= 0) & (along_line <= 1)
    return [int(k) for k in np.flatnonzero(inside)], along_step, np.asarray(cross > 0, dtype=np.float64)


def countable(scene: Scene, rules: ScoringRules) -> dict[TruthCrossing, bool]:
    """Tell which true crossings a perfect tracker could have counted: off the ends, seen often before."""
    rows = scene.rows
    since = scene.time_s - scene.origin_s
    frame = np.repeat(np.arange(len(since)), np.diff(rows.start))
    seen = rows.detections > 0
    first, last = since[0] + rules.countable_warm_s, since[-1] - rules.countable_tail_s
    return {
        crossing: bool(
            first <= crossing.t_s <= last
            and np.count_nonzero(since[frame[seen & (rows.vehicle == crossing.vehicle)]] <= crossing.t_s)
            >= rules.countable_frames
        )
        for crossing in scene.crossings
    }


def score_crossings(
    scene: Scene,
    found: Sequence[FoundCrossing],
    lane_partner: Mapping[TrackId, str],
    rules: ScoringRules,
) -> dict[str, float | int]:
    """Return the flow scores, of all crossings and of the countable ones.

    lane_partner: the true lane of a learned one; it names the lane of a crossing, else the nearest lane does.
    """
    events: dict[str, list[Event]] = {}
    for crossing, lane in zip(found, _lanes_of(scene, found, lane_partner), strict=True):
        events.setdefault(crossing.line_id, []).append(Event(crossing.t_s, lane, crossing.speed_mps))
    true: dict[str, list[TruthCrossing]] = {}
    for crossing_true in scene.crossings:
        true.setdefault(crossing_true.line_id, []).append(crossing_true)
    fair = countable(scene, rules)
    lines = [
        _Line(true.get(name, []), events.get(name, []), fair, rules)
        for name in sorted(set(true) | set(events))
    ]
    return _score_all(lines) | _score_countable(lines)


def _lanes_of(
    scene: Scene, found: Sequence[FoundCrossing], lane_partner: Mapping[TrackId, str]
) -> list[TrackId | None]:
    """Return the lane of each crossing: its own lane's partner, the nearest true lane, or the id as given."""
    at = np.array([(c.x_m, c.y_m) for c in found]).reshape(-1, 2)
    away = [feet(lane.points, at).distance_m for lane in scene.lanes]
    nearest = np.argmin(np.stack(away), axis=0) if away else np.empty(0, dtype=np.int64)
    out: list[TrackId | None] = []
    for k, crossing in enumerate(found):
        if crossing.lane_id is not None and crossing.lane_id in lane_partner:
            out.append(lane_partner[crossing.lane_id])
        elif len(nearest) and not math.isnan(crossing.x_m):
            out.append(scene.lanes[nearest[k]].lane_id)
        else:
            out.append(crossing.lane_id)
    return out


class _Line:
    """The crossings of one count line, true and found, and which belong together."""

    def __init__(
        self,
        true: list[TruthCrossing],
        found: list[Event],
        fair: Mapping[TruthCrossing, bool],
        rules: ScoringRules,
    ) -> None:
        self.true, self.found = true, found
        self.fair = [fair[crossing] for crossing in true]
        self.pairs = _pair(true, found, rules)
        self.ignored = self._ignored(rules.crossing_tolerance_s)

    def _ignored(self, tolerance_s: float) -> set[int]:
        """Return the found crossings that count neither way: near one that is not countable, or outside."""
        paired = {b: a for a, b in self.pairs}
        times = [crossing.t_s for crossing, fair in zip(self.true, self.fair, strict=True) if fair]
        first, last = min(times, default=0.0) - tolerance_s, max(times, default=0.0) + tolerance_s
        out: set[int] = set()
        for b, event in enumerate(self.found):
            if b in paired:
                ignore = not self.fair[paired[b]]
            else:
                near = (
                    not fair and abs(crossing.t_s - event.t_s) <= 2 * tolerance_s
                    for crossing, fair in zip(self.true, self.fair, strict=True)
                )
                ignore = any(near) or not first <= event.t_s <= last
            if ignore:
                out.add(b)
        return out


def _pair(true: list[TruthCrossing], found: list[Event], rules: ScoringRules) -> list[tuple[int, int]]:
    """Pair true and found crossings near in time, the right lane preferred."""
    if not true or not found:
        return []
    apart = np.abs(np.array([a.t_s for a in true])[:, None] - np.array([b.t_s for b in found]))
    other_lane = np.array([[a.lane_id != b.lane_id for b in found] for a in true])
    cost = apart + rules.wrong_lane_cost_s * other_lane
    reach = rules.crossing_tolerance_s + rules.wrong_lane_cost_s
    rows, columns = linear_sum_assignment(np.where(cost <= reach, cost, _NO_PAIR))
    good = apart[rows, columns] <= rules.crossing_tolerance_s
    return [(int(a), int(b)) for a, b in zip(rows[good], columns[good], strict=True)]


def _score_all(lines: Sequence[_Line]) -> dict[str, float | int]:
    true, found = sum(len(line.true) for line in lines), sum(len(line.found) for line in lines)
    hits = sum(len(line.pairs) for line in lines)
    lane_error = 0
    for line in lines:
        balance = Counter[TrackId | None](a.lane_id for a in line.true)
        balance.subtract(b.lane_id for b in line.found)
        lane_error += sum(abs(n) for n in balance.values())
    pairs = [(line.true[a], line.found[b]) for line in lines for a, b in line.pairs]
    return {
        "crossings_true": true,
        "crossings_found": found,
        "lane_count_error": lane_error / max(true, 1),
        "total_count_error": sum(abs(len(line.true) - len(line.found)) for line in lines) / max(true, 1),
        "crossing_recall": hits / max(true, 1),
        "crossing_precision": hits / max(found, 1),
        "lane_right": sum(a.lane_id == b.lane_id for a, b in pairs) / max(hits, 1),
        "flow_speed_mae_mps": _speed_error(pairs),
    }


def _score_countable(lines: Sequence[_Line]) -> dict[str, float | int]:
    true = found = net_error = lane_error = 0
    pairs: list[tuple[TruthCrossing, Event]] = []
    for line in lines:
        fair = [crossing for crossing, fair in zip(line.true, line.fair, strict=True) if fair]
        kept = [event for b, event in enumerate(line.found) if b not in line.ignored]
        true, found = true + len(fair), found + len(kept)
        net_error += abs(len(fair) - len(kept))
        balance = Counter[TrackId | None](a.lane_id for a in fair)
        balance.subtract(b.lane_id for b in kept)
        lane_error += sum(abs(n) for n in balance.values())
        pairs += [(line.true[a], line.found[b]) for a, b in line.pairs if line.fair[a]]
    late = np.array([b.t_s - a.t_s for a, b in pairs])
    return {
        "countable_true": true,
        "countable_found": found,
        "count_recall": len(pairs) / max(true, 1),
        "count_precision": len(pairs) / max(found, 1),
        "count_net_error": net_error / max(true, 1),
        "count_lane_error": lane_error / max(true, 1),
        "count_lane_right": sum(a.lane_id == b.lane_id for a, b in pairs) / max(len(pairs), 1),
        "crossing_time_bias_s": float(late.mean()) if pairs else math.nan,
        "crossing_time_sd_s": float(late.std()) if pairs else math.nan,
        "crossing_speed_mae_mps": _speed_error(pairs),
    }


def _speed_error(pairs: Sequence[tuple[TruthCrossing, Event]]) -> float:
    """Return the mean speed error of the pairs that have a speed, NaN without any."""
    apart = [abs(a.speed_mps - b.speed_mps) for a, b in pairs if not math.isnan(b.speed_mps)]
    return float(np.mean(apart)) if apart else math.nan
