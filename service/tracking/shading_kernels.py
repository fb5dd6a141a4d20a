"""The shadows of boxes on one another: what is seen of each, and to which side that moves its echoes."""

from __future__ import annotations

import math

import numpy as np

from service.tracking.boxes import (
    BCOS,
    BHIDDEN,
    BLEN,
    BSHIFT,
    BSIN,
    BVAR_SHIFT,
    BVAR_W,
    BWID,
    BX,
    BY,
)  # fmt: skip
from service.tracking.kernel import kernel, part
from service.tracking.model import F64, Bool

FACE_SAMPLES, SIDE_SAMPLES = 9, 5  # of the near end and of the side that faces the radar
SAMPLES = FACE_SAMPLES + SIDE_SAMPLES
PLACES, SHARES = (-1.2, 0.0, 1.2), (0.35, 0.3, 0.35)  # in standard deviations: of a normal distribution
# A ray that just touches an edge loses 6 dB (diffraction at a knife edge), one that passes below it more for
# each metre, but some of it comes round by the road.
GRAZING_DB, DB_PER_M, MOST_DB = 6.0, 14.0, 20.0
SIDE_SHARE = 1.2  # of the weight of a car's side, seen at a right angle, by that of its end, seen so
CAR_M = 4.5
LEVEL_M = 2.0  # who begins no more than this before another's near end is beside it
PARALLEL_M = 1e-9  # a ray along a face counts as crossing it so slowly
BELOW_MAST_M = 0.1  # what is as high as the radar throws a shadow without an end


@kernel
def shade_boxes(
    boxes: F64, certain: Bool, settled: Bool, mast: float, echo: float, q: tuple[float, ...]
) -> None:
    """Write BSHIFT and BVAR_SHIFT, clear BHIDDEN; see `service.tracking.shading`.

    certain (T,): who throws shadows; settled (T,): who is put right; mast and echo: heights in m; q: those of
    cars and of long vehicles, from which length on they are long, and of their echoes, and the limits.
    """
    car_height, long_height, long, long_echo, end_on, clear, lane, doubt, lit_face = q
    n = len(boxes)
    g, bearing, facing, half = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    depth, height, end = np.empty(n), np.empty(n), np.empty(n)
    for i in range(n):
        b = boxes[i]
        g[i], bearing[i] = max(math.hypot(b[BX], b[BY]), 1.0), math.atan2(b[BX], b[BY])
        facing[i] = abs(b[BSIN] * b[BX] + b[BCOS] * b[BY]) / g[i]
        across = math.sqrt(max(0.0, 1.0 - facing[i] * facing[i]))
        depth[i] = 0.5 * (b[BLEN] * facing[i] + b[BWID] * across)
        half[i] = 0.5 * (b[BWID] * facing[i] + b[BLEN] * across) / max(g[i] - depth[i], 1.0)
        height[i] = long_height if b[BLEN] > long else car_height
        end[i] = np.inf
        if height[i] < mast - BELOW_MAST_M:
            end[i] = (g[i] + depth[i]) * (mast - echo) / (mast - height[i])
    x, y, w = np.empty(SAMPLES), np.empty(SAMPLES), np.empty(SAMPLES)
    weight, loss, before = np.empty(SAMPLES), np.empty(SAMPLES), np.empty(n, np.int64)
    for i in range(n):
        if not settled[i] or facing[i] < end_on:
            continue
        b, found, unsure, near = boxes[i], 0, False, g[i] - depth[i]
        for j in range(n):
            if j == i or end[j] < near or g[j] - depth[j] > near - LEVEL_M:
                continue
            apart = abs(bearing[i] - bearing[j])
            if min(apart, 2.0 * math.pi - apart) > half[i] + half[j]:
                continue
            aside = b[BCOS] * (boxes[j, BX] - b[BX]) - b[BSIN] * (boxes[j, BY] - b[BY])
            if not certain[j] or (g[j] + depth[j] > near + clear and abs(aside) < lane):
                unsure = True
            else:
                before[found], found = j, found + 1
        if found == 0:
            if not unsure:
                b[BHIDDEN] = 0.0
            continue
        echoes = long_echo if b[BLEN] > long else echo
        std = math.sqrt(b[BVAR_W])
        mean = square = face = 0.0
        for k in range(len(PLACES)):  # as its own place is not certain, neither is what is in the shadow
            _sample(b, PLACES[k] * std, x, y, w, weight)
            loss[:] = 0.0
            for j in before[:found]:
                _darken(boxes[j], x, y, mast, echoes, height[j], loss)
            lit = lit_w = whole = whole_w = 0.0
            for m in range(SAMPLES):
                seen = 10.0 ** (-0.05 * loss[m])
                lit, lit_w = lit + weight[m] * seen, lit_w + weight[m] * seen * w[m]
                whole, whole_w = whole + weight[m], whole_w + weight[m] * w[m]
                if m < FACE_SAMPLES:
                    face += SHARES[k] * seen / FACE_SAMPLES
            shift = lit_w / lit - whole_w / whole
            mean, square = mean + SHARES[k] * shift, square + SHARES[k] * shift * shift
        b[BSHIFT] = mean
        b[BVAR_SHIFT] = (doubt * mean) ** 2 + max(square - mean * mean, 0.0)
        if face > lit_face and not unsure:
            b[BHIDDEN] = 0.0


@part
def _sample(b: F64, aside: float, x: F64, y: F64, w: F64, weight: F64) -> None:
    """Set out places on the faces that the radar sees, with their weight in the mean and place across.

    The box lies `aside` m to the right of its place.
    """
    g = max(math.hypot(b[BX], b[BY]), 1.0)
    to_radar = -(b[BSIN] * b[BX] + b[BCOS] * b[BY]) / g
    side_los = -(b[BCOS] * b[BX] - b[BSIN] * b[BY]) / g
    near, side = math.copysign(0.5 * b[BLEN], to_radar), math.copysign(0.5 * b[BWID], side_los)
    for k in range(SAMPLES):
        if k < FACE_SAMPLES:
            u, w[k] = near, b[BWID] * ((k + 0.5) / FACE_SAMPLES - 0.5)
            weight[k] = abs(to_radar) / FACE_SAMPLES
        else:
            u, w[k] = b[BLEN] * ((k - FACE_SAMPLES + 0.5) / SIDE_SAMPLES - 0.5), side
            weight[k] = SIDE_SHARE * abs(side_los) * b[BLEN] / (CAR_M * SIDE_SAMPLES)
        x[k] = b[BX] + b[BSIN] * u + b[BCOS] * (w[k] + aside)
        y[k] = b[BY] + b[BCOS] * u - b[BSIN] * (w[k] + aside)


@part
def _darken(o: F64, x: F64, y: F64, mast: float, echo: float, height: float, loss: F64) -> None:
    """Raise the losses, in dB, of the rays from the radar to (x, y) to what the box o takes of them."""
    half_u, half_w = 0.5 * o[BLEN], 0.5 * o[BWID]
    u0, w0 = -(o[BSIN] * o[BX] + o[BCOS] * o[BY]), -(o[BCOS] * o[BX] - o[BSIN] * o[BY])
    for k in range(SAMPLES):
        du, dw = o[BSIN] * x[k] + o[BCOS] * y[k], o[BCOS] * x[k] - o[BSIN] * y[k]
        du = math.copysign(max(abs(du), PARALLEL_M), du)
        dw = math.copysign(max(abs(dw), PARALLEL_M), dw)
        ta, tb, tc, td = (-half_u - u0) / du, (half_u - u0) / du, (-half_w - w0) / dw, (half_w - w0) / dw
        enters, leaves = max(min(ta, tb), min(tc, td)), min(max(ta, tb), max(tc, td))
        if enters >= leaves or leaves <= 0.0 or enters >= 1.0:
            continue
        below = height - (mast + (echo - mast) * min(leaves, 1.0))  # of the roof's edge, where the ray leaves
        if below > 0.0:
            loss[k] = max(loss[k], min(GRAZING_DB + DB_PER_M * below, MOST_DB))
