"""The compiled kernel of the association: connected components, exact and approximate marginals.

A hypothesis gives each track one measurement of its gate or none ("stay"), and each measurement to at most
one track; it weighs the product of its choices. Only measurements in several gates need the joint sum; the
others are ways to stay. An edge is a track with a shared measurement: those of a component's track i are
`start[i]:start[i + 1]`, and `column` holds their measurements.
"""

from __future__ import annotations

import numpy as np

from service.tracking.kernel import kernel, part
from service.tracking.model import F64, I64

INVALID = -1  # in place of the number of components: a weight is not a number
UNBALANCED = -2  # in place of the number of components: weights could underflow without prices

LBP_TOLERANCE = 1e-6  # largest relative change of a message, far below the method's own error
LBP_ITERATIONS = 200  # rounds; the message passing converges (Vontobel 2013), in practice within some tens
SMALLEST = 1e-100  # floor of the weights in the message passing, so that no quotient overflows


@part
def count_gates(log_weight: F64, log_miss: F64, component: I64, gates: I64) -> int:
    """Label the connected components of tracks (T,) and count the gates around each measurement (M,).

    Labels are numbered by their first track. Returns how many there are, or INVALID for NaN or infinite
    weights.
    """
    tracks, measurements = log_weight.shape
    first = np.empty(measurements, np.int64)
    for j in range(measurements):
        gates[j] = 0
    for i in range(tracks):
        component[i] = i
        if not (abs(log_miss[i]) < np.inf):
            return INVALID
        for j in range(measurements):
            if log_weight[i, j] == -np.inf:
                continue
            if not (log_weight[i, j] < np.inf):
                return INVALID
            if gates[j] == 0:
                first[j] = i
            gates[j] += 1
            a, b = first[j], i
            while component[a] != a:
                a = component[a]
            while component[b] != b:
                b = component[b]
            component[max(a, b)] = min(a, b)
    count = 0
    for i in range(
        tracks
    ):  # a root is the first track of its component, so parents are labelled before children
        if component[i] == i:
            component[i] = count
            count += 1
        else:
            component[i] = component[component[i]]
    return count


@part
def scale_row(
    log_weight: F64, log_miss: float, price: F64, gates: I64, power: float, weight: F64
) -> tuple[float, float, float]:
    """Write a row's weights (M,), to a power and with maximum 1, or -1 outside the gate.

    Returns the weights of no measurement and of staying, and the log of largest over smallest weight.
    """
    largest = smallest = log_miss
    for j in range(len(price)):
        if log_weight[j] > -np.inf:
            w = log_weight[j] - price[j]
            largest, smallest = max(largest, w), min(smallest, w)
    miss = np.exp(power * (log_miss - largest))
    stay = miss
    for j in range(len(price)):
        weight[j] = -1.0
        if log_weight[j] > -np.inf:
            weight[j] = np.exp(power * (log_weight[j] - price[j] - largest))
            if gates[j] == 1:
                stay += weight[j]
    return miss, stay, power * (largest - smallest)


@part
def order_tracks(start: I64, column: I64, gates: I64, first: int, order: I64) -> int:
    """Order the tracks from `first` on so that few measurements are live, and write it to `order` (T,).

    Live is a measurement that a placed and an unplaced track share. Next is always a track that can help to
    close the oldest live one, which sweeps a queue of vehicles from end to end; of several, the one that
    opens least. Returns the width: the most that are live while a track is placed.
    """
    tracks = len(order)
    remaining, opened_at = np.empty(len(gates), np.int64), np.empty(len(gates), np.int64)
    for j in range(len(gates)):
        remaining[j] = gates[j]
    for n in range(tracks):
        order[n] = n
    order[0], order[first] = first, 0
    live = width = 0
    for k in range(tracks):  # order[k:] are the tracks not placed yet
        best, best_oldest, best_growth, best_opened = k, tracks, 0, 0
        for n in range(k, tracks if k > 0 else 1):
            oldest, opened, closed = tracks, 0, 0
            for e in range(start[order[n]], start[order[n] + 1]):
                j = column[e]
                closed += remaining[j] == 1
                if remaining[j] == gates[j]:
                    opened += 1
                else:
                    oldest = min(oldest, opened_at[j])
            growth = opened - closed
            if n == k or oldest < best_oldest or (oldest == best_oldest and growth < best_growth):
                best, best_oldest, best_growth, best_opened = n, oldest, growth, opened
        i = order[best]
        order[best], order[k] = order[k], i
        for e in range(start[i], start[i + 1]):
            if remaining[column[e]] == gates[column[e]]:
                opened_at[column[e]] = k
            remaining[column[e]] -= 1
        width = max(width, live + best_opened)
        live += best_growth
    return width


@part
def assign_bits(start: I64, column: I64, gates: I64, order: I64, bit: I64, back: I64, layer: I64) -> int:
    """Give each measurement a bit while it is live; return how many states all layers have.

    Fills `bit` (E,), that of each edge at its track; `layer` (T + 1,), the live bits before each track of the
    order; `back` (E,), the bit given back after the edge's track, as numbered once those of the track's edges
    before it are gone, or -1.
    """
    current, remaining, owner = (
        np.empty(len(gates), np.int64),
        np.empty(len(gates), np.int64),
        np.empty(len(gates), np.int64),
    )
    for j in range(len(gates)):
        current[j], remaining[j] = -1, gates[j]
    live, states = 0, 1
    for k in range(len(order)):
        layer[k] = live
        states += 1 << live
        a, b = start[order[k]], start[order[k] + 1]
        for e in range(a, b):
            j = column[e]
            if current[j] < 0:
                current[j] = live
                owner[live] = j
                live += 1
            bit[e] = current[j]
            remaining[j] -= 1
        for e in range(a, b):
            back[e] = -1
            if remaining[column[e]] == 0:
                back[e] = current[column[e]]
                live -= 1
                for p in range(back[e], live):
                    owner[p] = owner[p + 1]
                    current[owner[p]] = p
    layer[len(order)] = live
    return states


@part
def forward(F: F64, stay: float, weight: F64, bit: I64, back: I64, idle: F64, G: F64, after: F64) -> None:
    """Place one track: from F (size,), the weight of all choices before it by bits used, to the next layer.

    Writes that layer to `after`, scaled to 1 at the largest so that nothing over- or underflows.
    """
    size = full = len(F)
    for e in range(len(bit)):
        full = max(full, 2 << bit[e])
    for s in range(full):
        G[s] = F[s] * stay if s < size else 0.0
    for e in range(len(bit)):
        use = 1 << bit[e]
        for high in range(0, size, 2 * use):
            for s in range(high, min(high + use, size)):
                G[s + use] += F[s] * weight[e]
    for e in range(len(bit)):
        if back[e] < 0:
            continue
        use = 1 << back[e]
        out = 0
        for high in range(0, full, 2 * use):  # `out` never overtakes what is still to be read
            for s in range(high, high + use):
                G[out] = idle[e] * G[s] + G[s + use]
                out += 1
        full = out
    largest = 0.0
    for s in range(full):
        largest = max(largest, G[s])
    for s in range(full):
        after[s] = G[s] / largest


@part
def backward(
    F: F64, stay: float, weight: F64, bit: I64, back: I64, idle: F64, G: F64, B: F64, edge: F64
) -> float:
    """Take one track back: from the weight G of all later choices by the bits used after it to those before.

    Writes the sums over all hypotheses with each edge to `edge`, returns that of staying. B is room like F.
    """
    size = full = len(F)
    for e in range(len(bit)):
        full = max(full, 2 << bit[e])
    for e in range(len(bit)):
        full >>= back[e] >= 0
    for e in range(len(bit) - 1, -1, -1):
        if back[e] < 0:
            continue
        use = 1 << back[e]
        source = full - 1
        for high in range(2 * full - 2 * use, -1, -2 * use):
            for s in range(high + use - 1, high - 1, -1):
                G[s + use] = G[source]
                G[s] = idle[e] * G[source]
                source -= 1
        full *= 2
    total = 0.0
    for s in range(size):
        total += F[s] * G[s]
        B[s] = G[s] * stay
    for e in range(len(bit)):
        use = 1 << bit[e]
        share = 0.0
        for high in range(0, size, 2 * use):
            for s in range(high, min(high + use, size)):
                share += F[s] * G[s + use]
                B[s] += weight[e] * G[s + use]
        edge[e] = weight[e] * share
    largest = 0.0
    for s in range(size):
        largest = max(largest, B[s])
    for s in range(size):
        G[s] = B[s] / largest
    return total * stay


@part
def propagate(start: I64, column: I64, weight: F64, stay: F64, idle: F64, edge: F64) -> None:
    """Write the approximate weight of each edge (E,) beside staying, by loopy belief propagation.

    Source: Williams and Lau 2014, IEEE Trans. AES 50(4), with a weight for idle measurements.
    """
    edges, measurements = len(column), 0
    for e in range(edges):
        measurements = max(measurements, column[e] + 1)
    total = np.empty(measurements)  # of each measurement's idle weight and odds
    odds = np.empty(edges)  # of this edge against the track's other options
    free = np.empty(edges)  # 1 / (weight of being idle or with another track)
    for e in range(edges):
        free[e] = 1.0 / max(idle[e], SMALLEST)
    for _ in range(LBP_ITERATIONS):
        for e in range(edges):
            total[column[e]] = max(idle[e], SMALLEST)
        for i in range(len(stay)):
            for e in range(start[i], start[i + 1]):
                rest = max(stay[i], SMALLEST)
                for other in range(start[i], start[i + 1]):
                    if other != e:
                        rest += weight[other] * free[other]
                odds[e] = weight[e] / rest
                total[column[e]] += odds[e]
        change = 0.0
        for e in range(edges):
            rest = max(total[column[e]] - odds[e], idle[e], SMALLEST)
            change = max(change, abs(1.0 - free[e] * rest))
            free[e] = 1.0 / rest
        if change < LBP_TOLERANCE:
            break
    for e in range(edges):
        edge[e] = weight[e] * free[e]


@part
def list_edges(
    weight: F64,
    price: F64,
    gates: I64,
    member: I64,
    power: float,
    start: I64,
    column: I64,
    edge: F64,
    idle: F64,
) -> int:
    """List the edges of a component's tracks, their weights and those of leaving their measurements idle."""
    e = 0
    for n in range(len(member)):
        start[n] = e
        for j in range(len(gates)):
            if gates[j] > 1 and weight[member[n], j] >= 0.0:
                column[e], edge[e], idle[e] = j, weight[member[n], j], np.exp(-power * price[j])
                e += 1
    start[len(member)] = e
    return e


@part
def write_row(
    weight: F64, miss: float, stay: float, stay_sum: float, gates: I64, column: I64, edge: F64
) -> float:
    """Turn a row's weights into probabilities by the sums over hypotheses; return that of no measurement."""
    total = stay_sum
    for e in range(len(edge)):
        total += edge[e]
    scale = stay_sum / total / stay if stay > 0.0 else 0.0
    for j in range(len(gates)):
        weight[j] = scale * weight[j] if gates[j] == 1 and weight[j] > 0.0 else 0.0
    for e in range(len(edge)):
        weight[column[e]] = edge[e] / total
    return miss * scale


@kernel
def solve(
    log_weight: F64,
    log_miss: F64,
    price: F64,
    safe_range: float,
    temper: float,
    max_width: int,
    beta: F64,
    miss: F64,
    component: I64,
) -> tuple[int, int]:
    """Fill beta (T, M), miss (T,), component (T,); return the numbers of components and of approximated ones.

    price: (M,) log by which each measurement's weights are lowered; any is right, good ones prevent
    underflow. safe_range: log span of a component's hypotheses above which the first number is UNBALANCED (or
    INVALID).
    """
    tracks, measurements = log_weight.shape
    gates = np.empty(measurements, np.int64)
    components = count_gates(log_weight, log_miss, component, gates)
    if components < 0:
        return INVALID, 0
    E, room, approximated = 0, tracks + 1, 0
    for j in range(measurements):
        E += gates[j]
    weight, idle, edge = np.empty(E), np.empty(E), np.empty(E)
    column, bit, back = np.empty(E, np.int64), np.empty(E, np.int64), np.empty(E, np.int64)
    member, start, layer = np.empty(room, np.int64), np.empty(room, np.int64), np.empty(room, np.int64)
    stay, stay_sum, orders = np.empty(tracks), np.empty(tracks), np.empty((2, tracks), np.int64)
    for label in range(components):
        size = 0
        for i in range(tracks):
            member[size] = i
            size += component[i] == label
        start[0] = start[1] = 0
        spread, power = 0.0, temper if size > 1 else 1.0
        for n in range(size):
            i = member[n]
            miss[i], stay[n], extent = scale_row(log_weight[i], log_miss[i], price, gates, power, beta[i])
            stay_sum[n] = stay[n]
            spread += extent
        if size > 1:
            if spread > safe_range:
                return UNBALANCED, 0
            E = list_edges(beta, price, gates, member[:size], power, start, column, weight, idle)
            width, first, way = 1 << 30, start[0], 0  # a bare 0 is a type of its own to compile for
            for n in range(2):  # the second time from where the first one ended
                other = order_tracks(start, column, gates, first, orders[n, :size])
                first = orders[n, size - 1]
                if other < width:
                    width, way = other, n
            order = orders[way]
            if width > max_width:
                approximated += 1
                propagate(start, column[:E], weight, stay[:size], idle, edge)
            else:
                states = assign_bits(start, column, gates, order[:size], bit, back, layer)
                F, G, B = np.empty(states), np.empty(1 << width), np.empty(1 << width)
                F[0] = G[0] = 1.0
                at = 0
                for k in range(size):
                    i, after = order[k], at + (1 << layer[k])
                    a, b = start[i], start[i + 1]
                    forward(F[at:after], stay[i], weight[a:b], bit[a:b], back[a:b], idle[a:b], G, F[after:])
                    at = after
                for k in range(size - 1, -1, -1):
                    i = order[k]
                    a, b = start[i], start[i + 1]
                    before = at - (1 << layer[k])
                    stay_sum[i] = backward(
                        F[before:at], stay[i], weight[a:b], bit[a:b], back[a:b], idle[a:b], G, B, edge[a:b]
                    )
                    at = before
        for n in range(size):
            i, a, b = member[n], start[n], start[n + 1]
            miss[i] = write_row(beta[i], miss[i], stay[n], stay_sum[n], gates, column[a:b], edge[a:b])
    return components, approximated
