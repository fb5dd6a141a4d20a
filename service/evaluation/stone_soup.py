"""Run frames of clusters through Stone Soup's joint probabilistic data association, to compare its time.

Stone Soup (extra `bench`) is set up as its users would for this radar: JPDA by loopy belief propagation, an
extended Kalman filter of constant velocity on bearing, range and range rate, tracks begun from six
measurements and ended after 1.5 s without one. It is helped where that is cheap: an analytic Jacobian, and a
coarse gate in front of its own, without which it takes two to three times as long. Clusters are made by our
own front end and their time is not counted.
"""

from __future__ import annotations

import datetime as dt
import math
from dataclasses import dataclass, field

import numpy as np
from stonesoup.base import Property
from stonesoup.dataassociator.neighbour import GNNWith2DAssignment
from stonesoup.dataassociator.probability import JPDAwithLBP
from stonesoup.deleter.time import UpdateTimeDeleter
from stonesoup.functions import gm_reduce_single
from stonesoup.hypothesiser import Hypothesiser
from stonesoup.hypothesiser.distance import DistanceHypothesiser
from stonesoup.hypothesiser.probability import PDAHypothesiser
from stonesoup.initiator.simple import MultiMeasurementInitiator
from stonesoup.measures import Mahalanobis
from stonesoup.models.base import ReversibleModel
from stonesoup.models.measurement.nonlinear import CartesianToBearingRangeRate2D
from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, ConstantVelocity
from stonesoup.predictor.kalman import ExtendedKalmanPredictor
from stonesoup.types.angle import Bearing
from stonesoup.types.array import StateVector, StateVectors
from stonesoup.types.detection import Detection
from stonesoup.types.prediction import GaussianStatePrediction
from stonesoup.types.state import GaussianState
from stonesoup.types.update import GaussianStateUpdate
from stonesoup.updater.kalman import ExtendedKalmanUpdater

from service.tracking.boxes import PG, PV, PVAR_AZ, PWEIGHT, PX, PY
from service.tracking.clustering import cluster_window
from service.tracking.clustering_parameters import ClusteringParameters
from service.tracking.model import F64, Frame
from service.tracking.parameters import TrackerParameters
from service.tracking.points import point_array

_ACCELERATION = (0.75, 1.5)  # noise density across and along the view, m^2/s^3
_DETECTION, _GATE, _CLUTTER_DENSITY = 0.85, 0.9995, 2e-3
_REACH_M = 8.0  # of the coarse gate
_DOUBLE_M, _DOUBLE_MPS = 2.5, 3.0  # two tracks so alike are one vehicle
_MIN_POINTS, _SILENT_S = 6, 1.5
_WIDTH_STD_M, _RANGE_STD_M, _RATE_STD_MPS = 0.5, 0.6, 0.4  # of a cluster as a measurement of its vehicle
_POSITION, _VELOCITY = (0, 2), (1, 3)  # in the state [x vx y vy]
_START = dt.datetime(2026, 1, 1)  # noqa: DTZ001 - only differences of times matter


class _Radar(CartesianToBearingRangeRate2D, ReversibleModel):  # type: ignore[misc]
    """Bearing, range and range rate, with the derivative and inverse that Stone Soup's own does not have."""

    def jacobian(self, state: GaussianState, **_: object) -> F64:
        x, vx, y, vy = (float(value) for value in state.state_vector[:, 0])
        r = math.hypot(x, y)
        rate = (x * vx + y * vy) / r
        return np.array(
            [
                [-y / r**2, 0.0, x / r**2, 0.0],
                [x / r, 0.0, y / r, 0.0],
                [vx / r - x * rate / r**2, x / r, vy / r - y * rate / r**2, y / r],
            ]
        )

    def inverse_function(self, detection: Detection, **_: object) -> StateVector:
        bearing, r, rate = (float(value) for value in detection.state_vector[:, 0])
        c, s = math.cos(bearing), math.sin(bearing)
        return StateVector([r * c, rate * c, r * s, rate * s])


class _Near(Hypothesiser):  # type: ignore[misc]
    """Leave to a hypothesiser only the detections near the track."""

    inner: Hypothesiser = Property(doc="The hypothesiser that judges what is left.")

    def hypothesise(
        self,
        track: GaussianState,
        detections: set[Detection],
        timestamp: dt.datetime,
        **more: object,
    ) -> object:
        x, vx, y, vy = (float(value) for value in track.state_vector[:, 0])
        ahead_s = (timestamp - track.timestamp).total_seconds()
        x, y = x + ahead_s * vx, y + ahead_s * vy
        near = {d for d in detections if math.hypot(d.metadata["x"] - x, d.metadata["y"] - y) < _REACH_M}
        return self.inner.hypothesise(track, near, timestamp, **more)


@dataclass(slots=True)
class StoneSoup:
    """A Stone Soup tracker and its tracks."""

    tracks: set[GaussianState] = field(default_factory=set)
    updater: ExtendedKalmanUpdater = field(default_factory=lambda: ExtendedKalmanUpdater(None))
    associator: JPDAwithLBP = field(init=False)
    initiator: MultiMeasurementInitiator = field(init=False)
    deleter: UpdateTimeDeleter = field(init=False)

    def __post_init__(self) -> None:
        predictor = ExtendedKalmanPredictor(
            CombinedLinearGaussianTransitionModel([ConstantVelocity(q) for q in _ACCELERATION])
        )
        probable = PDAHypothesiser(predictor, self.updater, _CLUTTER_DENSITY, _DETECTION, _GATE)
        nearest = DistanceHypothesiser(predictor, self.updater, Mahalanobis(), missed_distance=4)
        self.associator = JPDAwithLBP(_Near(probable))
        self.deleter = UpdateTimeDeleter(dt.timedelta(seconds=_SILENT_S))
        prior = GaussianState(StateVector([0.0] * 4), np.diag([1.0, 5.0**2, 1.0, 5.0**2]))
        self.initiator = MultiMeasurementInitiator(
            prior, self.deleter, GNNWith2DAssignment(_Near(nearest)), self.updater, min_points=_MIN_POINTS
        )

    def step(self, detections: set[Detection], timestamp: dt.datetime) -> int:
        """Take one frame of detections; return how many tracks there are."""
        hypotheses = self.associator.associate(self.tracks, detections, timestamp)
        taken: set[Detection] = set()
        for track in self.tracks:
            multiple = hypotheses[track]
            single = [h.prediction if not h else self.updater.update(h) for h in multiple]
            weight = np.array([float(h.probability) for h in multiple])
            mean, cov = gm_reduce_single(
                StateVectors([state.state_vector for state in single]),
                np.stack([state.covar for state in single], axis=2),
                weight,
            )
            # as in Stone Soup's own mixture tracker: what is less likely than a miss is none of the track's
            miss = max(w for h, w in zip(multiple, weight, strict=True) if not h)
            likely = {h.measurement for h, w in zip(multiple, weight, strict=True) if h and w > miss}
            taken |= likely
            if likely:
                track.append(GaussianStateUpdate(mean, cov, multiple, timestamp))
            else:
                track.append(GaussianStatePrediction(mean, cov, timestamp=timestamp))
        self.tracks -= self.deleter.delete_tracks(self.tracks)
        self.tracks -= _younger_doubles(self.tracks)
        self.tracks |= self.initiator.initiate(detections - taken, timestamp)
        return len(self.tracks)


def _younger_doubles(tracks: set[GaussianState]) -> set[GaussianState]:
    """Return the tracks that run beside an older one: Stone Soup keeps them, at the cost of its time."""
    ordered = sorted(tracks, key=lambda track: (-len(track), track.id))
    if not ordered:
        return set()
    state = np.array([track.state_vector[:, 0] for track in ordered], dtype=np.float64)
    place, velocity = state[:, _POSITION], state[:, _VELOCITY]
    same = np.hypot(*(place[:, None] - place).T) < _DOUBLE_M
    same &= np.hypot(*(velocity[:, None] - velocity).T) < _DOUBLE_MPS
    return {track for track, row in zip(ordered, np.tril(same, -1), strict=True) if row.any()}


def detections_of(frame: Frame, parameters: TrackerParameters) -> tuple[set[Detection], dt.datetime]:
    """Return the moving clusters of one frame as detections, and its time."""
    points = point_array(frame, parameters.sensor)
    points = points[~(np.abs(points[:, PV]) < parameters.clutter.standing_mps)]
    label = cluster_window(
        x_m=points[:, PX], y_m=points[:, PY], radial_velocity_mps=points[:, PV], age_s=np.zeros(len(points)),
        azimuth_std_rad=np.sqrt(points[:, PVAR_AZ]), weights=np.ones(len(points)), road_direction=None,
        parameters=ClusteringParameters(min_points=1.0),
    )  # fmt: skip
    timestamp = _START + dt.timedelta(microseconds=frame.time_us % 86_400_000_000)
    clusters = (points[label == c] for c in range(int(label.max(initial=-1)) + 1))
    return {_detection(cluster, timestamp) for cluster in clusters}, timestamp


def _detection(cluster: F64, timestamp: dt.datetime) -> Detection:
    """Return a cluster as the range of its near end, its mean bearing and its median range rate."""
    weight = cluster[:, PWEIGHT]
    x, y = (float(np.average(cluster[:, c], weights=weight)) for c in (PX, PY))
    r, bearing = float(cluster[:, PG].min()), math.atan2(y, x)
    known = cluster[np.isfinite(cluster[:, PV]), PV]
    rate = float(np.median(known)) if len(known) else 0.0
    variance = float(cluster[:, PVAR_AZ].mean()) / len(cluster) + (_WIDTH_STD_M / r) ** 2
    model = _Radar(
        4, _POSITION, np.diag([variance, _RANGE_STD_M**2, _RATE_STD_MPS**2]), velocity_mapping=_VELOCITY
    )
    place = {"x": r * math.cos(bearing), "y": r * math.sin(bearing)}
    vector = StateVector([Bearing(bearing), r, rate])
    return Detection(vector, timestamp=timestamp, measurement_model=model, metadata=place)
