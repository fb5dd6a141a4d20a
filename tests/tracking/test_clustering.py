"""DBSCAN against scikit-learn, the features it works on, and the lateral split."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.cluster import DBSCAN
from sklearn.metrics import adjusted_rand_score

from service.errors import InvalidInput
from service.tracking.clustering import (
    cluster_window,
    compensate,
    dbscan,
    features,
    road_axes,
    split_lateral,
)
from service.tracking.clustering_parameters import ClusteringParameters

REFERENCE = (
    Path(__file__).resolve().parents[2] / ".." / "shared" / "data" / "reference_vectors" / "dbscan.json"
)
DEFAULTS = ClusteringParameters()
FORWARD = np.array([0.0, 1.0])


def cloud(rng, points, *, extent=(12.0, 4.0, 3.0, 0.6)):
    """Random points, half of them in clumps."""
    centres = rng.uniform(0.0, 1.0, (max(1, points // 12), 4)) * extent
    clumped = centres[rng.integers(len(centres), size=points // 2)] + rng.normal(0.0, 0.35, (points // 2, 4))
    return np.vstack([clumped, rng.uniform(0.0, 1.0, (points - points // 2, 4)) * extent])


def same_partition(a, b):
    """Whether two labellings group the points alike, whatever the numbers."""
    pairs = {(int(p), int(q)) for p, q in zip(a, b, strict=True)}
    return len(pairs) == len({p for p, _ in pairs}) == len({q for _, q in pairs})


def assert_agrees(points, weights, min_weight):
    """Equal to scikit-learn but for border points, which go to the nearest core point."""
    oracle = DBSCAN(eps=1.0, min_samples=min_weight).fit(points, sample_weight=weights)
    core = np.zeros(len(points), bool)
    core[oracle.core_sample_indices_] = True

    labels = dbscan(points, weights, min_weight)

    assert same_partition(labels[core], oracle.labels_[core])
    np.testing.assert_array_equal(labels < 0, oracle.labels_ < 0)
    if core.any():
        for border in np.flatnonzero(~core & (labels >= 0)):
            nearest = np.linalg.norm(points[core] - points[border], axis=1).argmin()
            assert labels[border] == labels[core][nearest]
    return adjusted_rand_score(labels, oracle.labels_)


def numbered_by_first_point(labels):
    first_seen = list(dict.fromkeys(int(label) for label in labels if label >= 0))
    return first_seen == list(range(len(first_seen)))


def test_random_clouds_are_clustered_as_by_scikit_learn():
    rng = np.random.default_rng(1)
    agreement = []

    for number in range(40):
        points = cloud(rng, int(rng.integers(2, 400)))
        weights = rng.choice([0.25, 0.5, 1.0, 2.0], len(points)) if number % 2 else np.ones(len(points))
        agreement.append(assert_agrees(points, weights, int(rng.integers(1, 7))))

    assert np.mean(agreement) >= 0.99  # border points between two clusters are all that differs


def test_points_far_out_do_not_disturb():
    rng = np.random.default_rng(2)
    near = cloud(rng, 200)
    points = np.vstack([near, [[1e7, -1e7, 0, 0], [-1e7, 1e7, 0, 0]]])

    assert_agrees(points, np.ones(202), 4)
    assert dbscan(points, np.ones(202), 4).tolist() == [*dbscan(near, np.ones(200), 4), -1, -1]


def test_all_points_in_one_place_are_one_cluster():
    labels = dbscan(np.zeros((300, 4)), np.ones(300), 4)  # 44,850 pairs

    assert (labels == 0).all()


def test_a_distance_of_one_is_inside():
    points = np.zeros((3, 4))
    points[:, 0] = [0.0, 1.0, 2.0 + 1e-9]

    assert dbscan(points, np.ones(3), 2).tolist() == [0, 0, -1]


def test_pairs_on_the_edges_of_cells_are_found():
    points = np.zeros((50, 4))
    points[:, 0] = np.arange(50)
    points[:, 1] = 0.1

    assert (dbscan(points, np.ones(50), 2) == 0).all()


def test_weights_decide_what_is_core():
    points = np.zeros((4, 4))
    points[:, 0] = [0.0, 0.5, 10.0, 10.5]

    assert dbscan(points, np.array([3.0, 1.0, 1.0, 1.0]), 4).tolist() == [0, 0, -1, -1]


def test_weights_that_add_up_to_the_limit_but_for_rounding_are_enough():
    points, weights = np.zeros((10, 4)), np.full(10, 0.1)  # ten times 0.1 is 0.9999999999999999

    assert sum(weights) < 1.0
    assert (dbscan(points, weights, 1.0) == 0).all()
    assert (dbscan(points, weights, 1.0, engine="scikit-learn") == 0).all()


def test_a_border_point_joins_the_nearer_cluster():
    # Two clumps, and between them a point that touches one core point of each.
    x = np.array([-1.5, -1.3, -1.1, -0.9, 0.85, 1.1, 1.3, 1.5, 0.0])
    points = np.column_stack([x, np.zeros((9, 3))])

    labels = dbscan(points, np.ones(9), 4)
    mirrored = dbscan(points[::-1], np.ones(9), 4)

    assert labels.tolist() == [0, 0, 0, 0, 1, 1, 1, 1, 1]
    assert mirrored[0] == mirrored[1]


@given(st.integers(0, 2**32 - 1), st.integers(1, 120))
@settings(max_examples=50, deadline=None)
def test_the_order_of_the_points_changes_the_numbers_only(seed, count):
    rng = np.random.default_rng(seed)
    points, weights = np.round(cloud(rng, count), 1), rng.choice([0.3, 0.7, 1.1], count)  # rounded: many ties
    order = rng.permutation(count)

    labels = dbscan(points, weights, 3.0)
    shuffled = dbscan(points[order], weights[order], 3.0)

    assert same_partition(shuffled, labels[order])
    np.testing.assert_array_equal(shuffled < 0, labels[order] < 0)
    assert numbered_by_first_point(labels)
    assert numbered_by_first_point(shuffled)


def test_both_engines_agree():
    rng = np.random.default_rng(3)
    points, weights = cloud(rng, 300), rng.choice([0.5, 1.0, 1.5], 300)

    ours, reference = (dbscan(points, weights, 3.5, engine=engine) for engine in ("numba", "scikit-learn"))

    assert adjusted_rand_score(ours, reference) >= 0.99
    assert numbered_by_first_point(reference)
    np.testing.assert_array_equal(ours < 0, reference < 0)


def test_the_reference_vectors_agree():
    if not REFERENCE.exists():
        pytest.skip("reference vectors are not beside the repository")

    for case in json.loads(REFERENCE.read_text())["cases"]:
        points = np.zeros((len(case["points_x_y_t"]), 4))
        points[:, :3] = case["points_x_y_t"]
        points[:, :2] /= case["eps"]
        points[:, 2] = 0.0
        core = np.array(case["core"], bool)
        expected = np.array(case["labels"])

        labels = dbscan(points, np.ones(len(points)), case["min_samples"])

        assert same_partition(labels[core], expected[core])
        np.testing.assert_array_equal(labels < 0, expected < 0)
        assert adjusted_rand_score(labels, expected) >= 0.99


@pytest.mark.parametrize("engine", ["numba", "scikit-learn"])
def test_no_points_are_no_clusters(engine):
    assert dbscan(np.empty((0, 4)), np.empty(0), 4, engine=engine).shape == (0,)
    empty = {name: np.empty(0) for name in ("x_m", "y_m", "radial_velocity_mps", "age_s", "azimuth_std_rad")}
    labels = cluster_window(
        **empty, weights=np.empty(0), road_direction=None, parameters=replace(DEFAULTS, engine=engine)
    )
    assert labels.shape == (0,)


@pytest.mark.parametrize("bad", [np.full((2, 4), np.nan), np.zeros((2, 3)), np.zeros((3, 4))])
def test_features_that_cannot_be_clustered_are_refused(bad):
    with pytest.raises(InvalidInput, match="features"):
        dbscan(bad, np.ones(2), 4)


def columns(**changes):
    """Four points at 50 m with 10 m/s; `features` wants them in this order."""
    given_columns = {
        "along_m": np.full(4, 50.0),
        "across_m": np.zeros(4),
        "range_m": np.full(4, 50.0),
        "radial_velocity_mps": np.full(4, -10.0),
        "age_s": np.zeros(4),
        "azimuth_std_rad": np.full(4, 0.02),
    }
    return list((given_columns | changes).values())


def test_each_feature_is_in_units_of_its_radius():
    along_eps_m = (1.2 + 0.12 * 10.0) * (1.0 + 0.002 * 50.0)
    across_eps_m = np.hypot(1.3, 50.0 * 0.02)

    scaled = features(*columns(across_m=np.full(4, 3.0), age_s=np.full(4, 0.1)), DEFAULTS)

    np.testing.assert_allclose(scaled[0], [50.0 / along_eps_m, 3.0 / across_eps_m, -10.0 / 1.2, 0.1 / 0.5])


@pytest.mark.parametrize(("speed_mps", "radius_m"), [(0.0, 1.4), (5.0, 1.8), (40.0, 3.0)])
def test_the_radius_along_the_road_grows_with_the_median_speed(speed_mps, radius_m):
    scaled = features(*columns(radial_velocity_mps=np.full(4, speed_mps)), DEFAULTS)

    assert 50.0 / scaled[0, 0] == pytest.approx(radius_m * 1.1)


@pytest.mark.parametrize("count", [1, 2, 3, 10, 57, 1040, 1041])
@pytest.mark.parametrize("decimals", [0, 1, 12], ids=["many alike", "some alike", "all different"])
def test_the_radii_follow_from_the_medians(count, decimals):
    rng = np.random.default_rng(count)
    doppler = np.round(rng.uniform(-14.0, 14.0, count), decimals)
    azimuth_std_rad = np.round(rng.uniform(0.01, 0.5, count), decimals + 1)
    ones, known = np.ones(count), rng.random(count) < 0.8
    doppler[~known] = np.nan

    scaled = features(ones, ones, ones, doppler, ones, azimuth_std_rad, DEFAULTS)

    speed_mps = (
        np.median(np.abs(doppler[known])) if known.any() else (2.2 - 1.2) / 0.12
    )  # the middle of the limits
    along_m = np.clip(1.2 + 0.12 * speed_mps, 1.4, 3.0) * 1.002
    np.testing.assert_allclose(scaled[:, 0], 1.0 / along_m)
    np.testing.assert_allclose(scaled[:, 1], 1.0 / np.hypot(1.3, np.median(azimuth_std_rad)))


def test_features_of_no_points_and_of_noise_that_is_no_number_have_an_end():
    nothing = np.zeros(0)

    assert features(*[nothing] * 6, DEFAULTS).shape == (0, 4)
    assert features(*columns(azimuth_std_rad=np.full(4, np.nan)), DEFAULTS).shape == (4, 4)


def test_without_any_doppler_nothing_is_separated_by_it():
    scaled = features(*columns(radial_velocity_mps=np.full(4, np.nan)), DEFAULTS)

    assert np.isfinite(scaled).all()
    assert np.ptp(scaled[:, 2]) == 0.0
    assert 50.0 / scaled[0, 0] == pytest.approx(2.2 * 1.1)


def test_a_point_without_doppler_belongs_to_its_nearest_neighbour():
    doppler = np.array([-10.0, -20.0, np.nan, np.nan])
    along = np.array([50.0, 60.0, 51.0, 59.0])

    scaled = features(*columns(radial_velocity_mps=doppler, along_m=along), DEFAULTS)

    np.testing.assert_allclose(scaled[:, 2] * 1.2, [-10.0, -20.0, -10.0, -20.0])


def test_older_points_move_along_the_line_of_sight():
    x, y = compensate(np.array([30.0]), np.array([40.0]), np.array([10.0]), np.array([0.2]), None, DEFAULTS)

    np.testing.assert_allclose([x[0], y[0]], [30.0 + 2.0 * 0.6, 40.0 + 2.0 * 0.8])


@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.parametrize("shape", [(2,), (1, 2)])
def test_older_points_move_along_the_road_whichever_way_it_is_given(way, shape):
    # At (30, 40) a vehicle at -15 m/s along y has a radial velocity of -15 * 0.8.
    road = (way * FORWARD).reshape(shape)

    x, y = compensate(np.array([30.0]), np.array([40.0]), np.array([-12.0]), np.array([0.2]), road, DEFAULTS)

    np.testing.assert_allclose([x[0], y[0]], [30.0, 40.0 - 3.0])


def test_compensation_is_bounded_where_the_road_crosses_the_line_of_sight():
    road = np.array([1.0, 0.0])

    x, y = compensate(np.array([1.0]), np.array([50.0]), np.array([3.0]), np.array([0.2]), road, DEFAULTS)

    np.testing.assert_allclose([x[0], y[0]], [1.0 + 0.2 * 3.0 / 0.3, 50.0])


def test_points_without_doppler_and_points_at_the_origin_stay():
    x, y = compensate(
        np.array([5.0, 0.0]), np.array([50.0, 0.0]), np.array([np.nan, 1.0]), np.full(2, 0.2), None, DEFAULTS
    )

    np.testing.assert_allclose([x[0], y[0], x[1], y[1]], [5.0, 50.0, 0.0, 0.0])


def test_road_axes_are_a_rotation():
    x, y = np.array([3.0, -2.0]), np.array([50.0, 70.0])
    road = np.array([0.6, 0.8])

    along, across = road_axes(x, y, road)

    np.testing.assert_allclose(along**2 + across**2, x**2 + y**2)
    np.testing.assert_allclose(road_axes(*road[:, None], road), [[1.0], [0.0]], atol=1e-15)
    np.testing.assert_array_equal(road_axes(x, y, None), [y, x])


def vehicle(
    rng, x_m, y_m, *, speed_mps=-15.0, points=5, frames=4, width_m=1.8, length_m=4.5, azimuth_std_rad=0.004
):
    """Rows x, y, radial velocity, age of a vehicle's points in a window of frames at 20 Hz."""
    rows = []
    for age_s in 0.05 * np.arange(frames):
        x = x_m + rng.uniform(-0.5, 0.5, points) * width_m
        y = y_m - speed_mps * age_s + rng.uniform(-0.5, 0.5, points) * length_m
        range_m, azimuth_rad = np.hypot(x, y), np.arctan2(x, y)
        doppler = speed_mps * np.cos(azimuth_rad) + rng.normal(0.0, 0.1, points)
        range_m, azimuth_rad = (
            range_m + rng.normal(0, 0.15, points),
            azimuth_rad + rng.normal(0, azimuth_std_rad, points),
        )
        rows.append(
            np.column_stack(
                [
                    range_m * np.sin(azimuth_rad),
                    range_m * np.cos(azimuth_rad),
                    doppler,
                    np.full(points, age_s),
                ]
            )
        )
    return np.vstack(rows)


def labels_of(*vehicles, parameters=DEFAULTS, road_direction=FORWARD):
    x, y, doppler, age = np.vstack(vehicles).T
    return cluster_window(
        x_m=x,
        y_m=y,
        radial_velocity_mps=doppler,
        age_s=age,
        azimuth_std_rad=np.full(len(x), 0.004),
        weights=np.ones(len(x)),
        road_direction=road_direction,
        parameters=parameters,
    )


@pytest.mark.parametrize("engine", ["numba", "scikit-learn"])
def test_two_cars_side_by_side_at_the_same_speed_are_told_apart(engine):
    rng = np.random.default_rng(4)

    labels = labels_of(
        vehicle(rng, -1.75, 60.0), vehicle(rng, 1.75, 60.0), parameters=replace(DEFAULTS, engine=engine)
    )

    assert set(labels[:20]) == {0}
    assert set(labels[20:]) == {1}


def test_three_cars_abreast_are_told_apart():
    rng = np.random.default_rng(5)

    labels = labels_of(*(vehicle(rng, x, 50.0) for x in (-3.5, 0.0, 3.5)))

    assert [set(labels[n : n + 20]) for n in (0, 20, 40)] == [{0}, {1}, {2}]


@pytest.mark.parametrize(
    "size", [{"length_m": 13.0, "width_m": 2.5, "points": 14}, {"width_m": 2.2, "points": 8}]
)
def test_one_long_or_wide_vehicle_stays_one(size):
    rng = np.random.default_rng(6)

    assert set(labels_of(vehicle(rng, 1.0, 60.0, **size))) == {0}


def test_cars_behind_one_another_and_at_other_speeds_are_apart():
    rng = np.random.default_rng(7)
    cars = [vehicle(rng, 0.0, 50.0), vehicle(rng, 0.0, 65.0), vehicle(rng, 2.0, 50.0, speed_mps=-11.0)]

    labels = labels_of(*cars)

    assert [set(labels[n : n + 20]) for n in (0, 20, 40)] == [{0}, {1}, {2}]


def test_a_window_without_a_road_or_doppler_is_clustered():
    rng = np.random.default_rng(8)
    cars = [vehicle(rng, 0.0, 50.0, speed_mps=-2.0), vehicle(rng, 0.0, 65.0, speed_mps=-2.0)]
    for car in cars:
        car[:, 2] = np.nan

    labels = labels_of(*cars, road_direction=None)

    assert [set(labels[:20]), set(labels[20:])] == [{0}, {1}]


def test_a_gap_wide_enough_is_cut_only_when_there_are_points_enough():
    across = np.array([-1.7, -1.8, -1.6, 1.7, 1.8, 1.6])
    narrow = np.full(6, 0.001)

    def split(count, parameters=DEFAULTS):
        return split_lateral(
            np.zeros(count, np.int64), across[6 - count :], np.full(count, 50.0), narrow[:count], parameters
        ).tolist()

    assert split(6) == [0, 0, 0, 1, 1, 1]
    assert split(5) == [0, 0, 0, 0, 0]
    assert split(6, replace(DEFAULTS, split_separation_m=3.5)) == [0, 0, 0, 0, 0, 0]
    assert split(6, replace(DEFAULTS, split_rounds=0)) == [0, 0, 0, 0, 0, 0]


@given(st.integers(0, 2**32 - 1), st.integers(0, 150))
@settings(max_examples=50, deadline=None)
def test_the_split_never_joins_and_never_touches_noise(seed, count):
    rng = np.random.default_rng(seed)
    labels = rng.integers(-1, 5, count)
    across, range_m = rng.normal(0.0, 4.0, count), rng.uniform(20.0, 150.0, count)
    before = labels.copy()
    order = rng.permutation(count)

    after = split_lateral(labels, across, range_m, np.full(count, 0.004), DEFAULTS)
    shuffled = split_lateral(labels[order], across[order], range_m[order], np.full(count, 0.004), DEFAULTS)

    np.testing.assert_array_equal(labels, before)
    np.testing.assert_array_equal(after < 0, before < 0)
    for piece in range(after.max(initial=-1) + 1):
        assert len(set(before[after == piece])) == 1
    assert numbered_by_first_point(after)
    assert same_partition(shuffled, after[order])


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("engine", "k-means"),
        ("min_points", 0.0),
        ("eps_age_s", np.nan),
        ("eps_across_m", -1.0),
        ("eps_along_max_m", 1.0),
        ("window_frames", 0),
    ],
)
def test_parameters_that_make_no_sense_are_refused(name, value):
    with pytest.raises(InvalidInput, match=f"clustering/{name}"):
        replace(DEFAULTS, **{name: value})
