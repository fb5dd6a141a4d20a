from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import orjson
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import binom, nbinom, poisson

from service.api.flow_json import rows_json
from service.errors import InvalidInput, NotFound
from service.formats.length_class import LENGTH_BOUNDS_M
from service.formats.local_days import interval_edges_us
from service.formats.rfc3339 import parse_time_us
from service.storage.flow_exports import csv_rows, pems_rows
from service.traffic.count_check import check
from service.traffic.count_intervals import (
    Confidence,
    Counted,
    counting_pmf,
    highest_density,
    volume_bounds,
)
from service.traffic.flow import Group, Received, covered, crossing_table, flow_table, percentile
from service.traffic.flow_fields import (
    RowName,
    crossing_fields,
    flow_columns,
    flow_fields,
    groups_of,
    parse_row_name,
    row_name,
    rows_of,
)
from service.traffic.movements import movements
from service.traffic.records import CROSSING, MINUTE_US, Crossing, record_of

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
import recompute_flow

START_US = 1_747_029_600_000_000  # 06:00
HOUR_US = 60 * MINUTE_US
ALL = Group("C40", None, None, None)


def table_of(*crossings):
    records = b"".join(record_of(crossing).tobytes() for crossing in crossings)
    minutes = np.array([crossing.time_us // MINUTE_US for crossing in crossings], np.int64)
    lines = np.array([crossing.line_id for crossing in crossings], dtype=np.str_)
    epoch = np.ones(len(crossings), np.int64)
    return crossing_table(np.frombuffer(records, CROSSING), minutes, epoch, lines, LENGTH_BOUNDS_M)


def crossing(second, speed_mps=15.0, *, number=1, line_id="C40", **given):
    values = {
        "line_id": line_id, "time_us": START_US + round(second * 1e6), "track": number, "vehicle": number,
        "frame": 1, "lane": 1, "direction": -1, "x_m": 0.0, "y_m": 40.0, "speed_mps": speed_mps,
        "length_m": 4.5, "probability": 1.0, "number": number,
    }  # fmt: skip
    return Crossing(**values | given)


def received(minutes=60, frames=1200, observed_us=MINUTE_US):
    count = np.arange(minutes) + START_US // MINUTE_US
    return Received(count, *(np.full(minutes, n) for n in (frames, 1200, observed_us)))


def flow(crossings, *, edges=(0, 60), groups=(ALL,), got=None):
    edges_us = START_US + np.array(edges, np.int64) * MINUTE_US
    return flow_table(crossings, received() if got is None else got, edges_us, groups)


def test_the_measures_are_those_of_the_definitions():
    found = flow(
        table_of(crossing(1, 10.0), crossing(5, 20.0, number=2), crossing(9, 30.0, number=3)), edges=(0, 1)
    )

    assert found.n.tolist() == [3]
    assert found.flow_vph[0] == 180
    assert found.time_mean_speed_mps[0] == 20
    assert found.space_mean_speed_mps[0] == pytest.approx(3 / (1 / 10 + 1 / 20 + 1 / 30))
    assert found.density_per_km[0] == pytest.approx(180 / (3.6 * found.space_mean_speed_mps[0]))
    assert found.occupancy_percent[0] == pytest.approx(100 / 60 * 6.5 * (1 / 10 + 1 / 20 + 1 / 30))
    assert found.p85_speed_mps[0] == pytest.approx(27.0)
    assert np.flatnonzero(found.histogram[0]).tolist() == [4, 8, 12]


def test_null_is_not_zero():
    found = flow_fields("radar-1", flow(table_of(), edges=(0, 1, 2), got=received(1)))

    (row,) = found  # of the second minute nothing was received
    assert (row["volume"], row["flow_vph"], row["occupancy_percent"]) == (0, 0.0, 0.0)
    assert row["time_mean_speed_mps"] is None
    assert row["p85_speed_mps"] is None
    assert row["mean_headway_s"] is None


def test_intervals_are_half_open():
    found = flow(table_of(crossing(0), crossing(60, number=2), crossing(120, number=3)), edges=(0, 1, 2))

    assert found.n.tolist() == [1, 1]


def test_the_peak_hour_factor_is_of_the_quarters_inside_the_hour():
    quarters = [10, 20, 40, 30]
    passed = [
        crossing(900 * q + k, number=100 * q + k + 1)
        for q, count in enumerate(quarters)
        for k in range(count)
    ]

    hour, *quarter = flow(table_of(*passed)).peak_hour_factor, flow(table_of(*passed), edges=(0, 15, 30))

    assert hour.tolist() == [100 / 160]
    assert np.isnan(quarter[0].peak_hour_factor).all()


def test_coverage_is_of_frames_and_observed_is_of_time():
    got = received(2, frames=600, observed_us=MINUTE_US // 2)

    coverage, observed = covered(got, START_US + np.array([0, 5, 10]) * MINUTE_US)

    assert coverage.tolist() == [pytest.approx(0.2), 0.0]  # of five minutes two came by half
    assert observed.tolist() == [pytest.approx(0.2), 0.0]


speeds = st.lists(st.floats(0.1, 60.0), min_size=1, max_size=40)


@settings(max_examples=60, deadline=None)
@given(speeds, st.integers(0, 2**32 - 1))
def test_every_figure_is_what_another_program_computes_from_the_exported_crossings(values, seed):
    rng = np.random.default_rng(seed)
    crossings = table_of(
        *(
            crossing(
                rng.uniform(0, 3600), v, number=k + 1, lane=int(rng.integers(1, 4)),
                direction=int(rng.choice([-1, 1])), length_m=rng.choice([np.nan, 4.2, 9.0, 17.5]),
                headway_s=rng.choice([np.nan, 2.5, 7.75]), gap_s=rng.choice([np.nan, 1.25]),
            )
            for k, v in enumerate(values)
        )
    )  # fmt: skip
    for by in ({"lane", "direction"}, {"lane", "direction", "length_class"}):
        groups = groups_of(crossings, ["C40"], (), frozenset(by))
        found = flow(crossings, edges=(0, 60), groups=groups)
        assert (found.space_mean_speed_mps <= found.time_mean_speed_mps)[found.n > 0].all()

        worst = recompute_flow.differences(
            crossing_fields("radar-1", crossings), flow_fields("radar-1", found)
        )

        assert {name for name, apart in worst.items() if apart > recompute_flow.ROUNDING} == set()


def test_a_row_is_opened_by_its_name():
    group = Group("A 1", 2, -1, "long")

    assert parse_row_name(row_name(group, 1_747_029_600, 900)) == RowName(
        group, START_US, START_US + 15 * MINUTE_US
    )
    for wrong in (
        "",
        "abc",
        "W10-1-60",
        "WyJDNDAiXQ-1-60",
        "a-1-x",
        row_name(Group("x", None, None, "huge"), 0, 60),
    ):
        with pytest.raises(NotFound):
            parse_row_name(wrong)


def counted(n, *, doubt=0.0, observed=1.0, density_per_km=10.0, range_m=40.0, headways=0, spread=0.0):
    shape = np.ones(np.size(n))
    return Counted(
        np.atleast_1d(n), doubt * shape, observed * shape, density_per_km / 1e3 * shape, range_m * shape,
        np.broadcast_to(headways, np.shape(shape)), spread * shape,
    )  # fmt: skip


def test_the_interval_of_a_volume_grows_with_doubt_with_time_not_seen_and_with_what_hides():
    low, high = volume_bounds(counted(40), Confidence())
    assert low[0] <= 40 <= high[0]

    assert volume_bounds(counted(40, doubt=4.0), Confidence())[0] < low
    assert volume_bounds(counted(40, observed=0.6), Confidence())[1] > 40 / 0.6 > high
    assert volume_bounds(counted(40, range_m=120.0), Confidence())[1] > high
    assert volume_bounds(counted(40, range_m=120.0), Confidence(mount_height_m=12.0))[1] == high
    assert [bound.tolist() for bound in volume_bounds(counted(0), Confidence())] == [[0], [0]]


def test_where_vehicles_follow_one_another_fewer_may_be_missing_than_at_random():
    at_random = volume_bounds(counted(40, observed=0.7, headways=40, spread=39.0), Confidence())
    in_a_row = volume_bounds(counted(40, observed=0.7, headways=40, spread=4.0), Confidence())
    unknown = volume_bounds(counted(40, observed=0.7), Confidence())

    assert unknown == at_random
    assert in_a_row[1] - in_a_row[0] < 0.7 * (at_random[1] - at_random[0])
    assert np.mean(in_a_row) == pytest.approx(np.mean(at_random), abs=1)  # as many are likely to be


def renewals(rng, rate_per_s, shape, end_s):
    """Arrivals in [0, end_s) whose headways are of a gamma distribution with this shape."""
    number = int(3 * rate_per_s * end_s) + 30
    return np.cumsum(rng.gamma(shape, 1 / (shape * rate_per_s), number)) - rng.uniform(0, 1 / rate_per_s)


@pytest.mark.parametrize("shape", [1.0, 4.0])  # Poisson arrivals, and vehicles that follow one another
def test_the_interval_holds_the_truth_as_often_as_it_says(shape):
    rng = np.random.default_rng(5)  # 1,500 intervals; binomial standard deviation 0.6 %
    level = Confidence(miss_share=0.05, false_share=0.02, hiding_deviation=0.0)
    cells, true = [], []
    for rate_per_s in rng.uniform(0.1, 0.6, 1500):
        seen_s = rng.uniform(36, 60)
        arrivals = renewals(rng, rate_per_s, shape, 60)
        arrivals = arrivals[(arrivals >= 0) & (arrivals < 60)]
        seen = arrivals[(arrivals < seen_s) & (rng.uniform(size=len(arrivals)) < 0.95)]
        n = len(seen) + rng.poisson(0.02 * len(seen))
        headways = np.diff(seen)
        spread = np.sum((headways / headways.mean() - 1) ** 2) if len(headways) else 0.0
        cells.append((n, seen_s / 60, len(headways), spread))
        true.append(len(arrivals))
    n, observed, headways, spread = np.array(cells).T
    found = counted(
        n.astype(int), observed=observed, range_m=0.0, headways=headways.astype(int), spread=spread
    )

    low, high = volume_bounds(found, level)

    assert 0.92 <= np.mean((low <= true) & (true <= high)) <= 0.98


@pytest.mark.parametrize(
    ("day", "hours"), [("2025-03-29", 24), ("2025-03-30", 23), ("2025-10-26", 25), ("2025-10-27", 24)]
)
def test_a_local_day_has_23_24_or_25_hours(day, hours):
    noon_us = parse_time_us(f"{day}T12:00:00Z")

    edges = interval_edges_us(noon_us, noon_us + 1, "day", "Europe/Berlin")

    assert np.diff(edges).tolist() == [hours * HOUR_US]
    assert edges[0] % (15 * MINUTE_US) == 0


def test_days_of_another_place_and_wrong_zones():
    start_us = parse_time_us("2025-03-30T00:30:00Z")

    edges = interval_edges_us(start_us, start_us + 30 * HOUR_US, "day", "America/New_York")

    assert edges[0] == parse_time_us("2025-03-29T00:00:00-04:00")
    with pytest.raises(InvalidInput):
        interval_edges_us(0, 1, "day", "Mars/Olympus")
    with pytest.raises(InvalidInput):
        interval_edges_us(0, 10**15, "1min", "UTC")


def test_the_coverage_of_a_day_with_25_hours_is_of_25_hours():
    start_us = parse_time_us("2025-10-26T00:00:00+02:00")
    minute = start_us // MINUTE_US + np.arange(25 * 60)
    got = Received(minute, *(np.full(25 * 60, n) for n in (1200, 1200, MINUTE_US)))

    coverage, _ = covered(got, interval_edges_us(start_us, start_us + 1, "day", "Europe/Berlin"))

    assert coverage.tolist() == [1.0]


def test_movements_are_from_the_first_gate_to_the_last():
    passed = table_of(
        crossing(1, number=1, line_id="north"),
        crossing(5, number=2, line_id="middle", vehicle=1, track=9, probability=0.5),
        crossing(9, number=3, line_id="west", vehicle=1, track=9),
        crossing(4, number=4, line_id="east", vehicle=2, length_m=np.nan),
    )

    found = movements(passed, START_US + np.array([0, 1]) * MINUTE_US)

    assert [(row.entry, row.exit, row.length_class, row.volume) for row in found] == [
        ("east", None, None, 1),
        ("north", "west", "short", 1),
    ]


def test_geh_is_of_hourly_volumes():
    found = check(counted=100, measured=110, interval_s=900)

    assert found.geh == pytest.approx(np.sqrt(2 * 40**2 / 840))
    assert (found.difference, found.relative_error, found.within_target) == (10, 0.1, True)
    assert check(0, 0, 900).geh == 0.0


def test_exports_name_their_units_and_speeds_are_converted():
    crossings = table_of(crossing(1, 10.0), crossing(2, 20.0, number=2, lane=2))
    found = flow(
        crossings, edges=(0, 1), groups=groups_of(crossings, (), (), frozenset({"lane", "direction"}))
    )

    head, first, _ = csv_rows(
        flow_fields("radar-1", found),
        ("line_id", "time_mean_speed_mps", "p85_speed_mps", "mean_gap_s"),
        "kmh",
    )
    pems = list(pems_rows(found, "Europe/Berlin"))

    assert head == "line_id,time_mean_speed_kmh,p85_speed_kmh,mean_gap_s\r\n"
    assert first == "C40,36.0,36.0,\r\n"
    assert pems[0].startswith("Timestamp,Station,Direction of Travel,Samples,% Observed,Total Flow")
    assert pems[1].split(",")[:8] == ["05/12/2025 08:00:00", "C40", "-1", "2", "100", "2", "0.0081", "33.6"]


def test_a_row_says_whether_it_is_of_a_lane_of_all_or_of_vehicles_in_none():
    groups = (ALL, Group("C40", 2, None, None), Group("C40", 0, None, None))
    rows = flow_fields("radar-1", flow(table_of(crossing(1, lane=2), crossing(2, lane=0)), groups=groups))

    assert [(row["lane_id"], row["lane_scope"], row["volume"]) for row in rows] == [
        (None, "all_lanes", 2),
        ("L2", "lane", 1),
        (None, "no_lane", 1),
    ]


@pytest.mark.parametrize("histogram", [True, False])
@pytest.mark.parametrize("count", [0, 3])
def test_a_table_is_written_as_json_like_its_rows(histogram, count):
    crossings = table_of(
        *(
            crossing(10 * k + 1, 12.3456, number=k, lane=k, **({"length_m": np.nan} if k == 1 else {}))
            for k in range(count)
        )
    )
    groups = groups_of(crossings, (), (), frozenset({"lane", "direction"}))
    found = flow(crossings, edges=(0, 1, 2), got=received(1, 2), groups=groups)
    columns = flow_columns('radar "1"', found, histogram=histogram)

    written = orjson.loads(orjson.dumps(rows_json(columns)))

    assert written == flow_fields('radar "1"', found, histogram=histogram)
    assert len(written) == len(found.n)
    assert all(("speed_histogram" in row) is histogram for row in written)


def test_a_text_with_quotes_in_a_column_of_texts_is_written_as_it_is():
    columns = {"row": ['a","b', "c"], "n": np.array([1, 2])}

    assert orjson.loads(orjson.dumps(rows_json(columns))) == rows_of(columns)


def test_groups_are_those_seen():
    crossings = table_of(
        crossing(1, lane=2, direction=-1), crossing(2, lane=0, direction=1, line_id="A"), crossing(3, lane=2)
    )

    by_both = groups_of(crossings, (), (), frozenset({"lane", "direction"}))
    by_direction = groups_of(crossings, (), (), frozenset({"direction"}))

    ways = sorted({-1, int(crossings.direction[-1])})
    assert [(g.line_id, g.lane, g.direction) for g in by_both] == [("A", 0, 1)] + [
        ("C40", 2, w) for w in ways
    ]
    assert [(g.line_id, g.lane, g.direction) for g in by_direction] == [("A", None, 1)] + [
        ("C40", None, w) for w in ways
    ]


def test_counts_of_missed_vehicles_are_binomial_poisson_or_negative_binomial_by_their_variance():
    k = np.arange(128)

    found = counting_pmf(np.array([6.0, 6.0, 6.0, 0.0]), np.array([4.5, 6.0, 12.0, 0.0]), 128)

    np.testing.assert_allclose(found[0], binom.pmf(k, 24, 0.25), atol=1e-12)
    np.testing.assert_allclose(found[1], poisson.pmf(k, 6.0), atol=1e-12)
    np.testing.assert_allclose(found[2], nbinom.pmf(k, 6.0, 0.5), atol=1e-12)
    assert found[3, 0] == pytest.approx(1.0)


def test_the_most_likely_values_are_as_few_as_can_be(rng):
    pmf = np.stack([np.sort(rng.dirichlet(np.ones(9))) for _ in range(50)])
    pmf = np.concatenate([pmf[:, 1::2], pmf[:, ::-2]], axis=1)  # one hill each

    low, high = highest_density(pmf, 0.9)

    total = np.concatenate([np.zeros((50, 1)), np.cumsum(pmf, axis=1)], axis=1)
    for i in range(50):
        share = total[i][None, 1:] - total[i][:-1, None]  # of first to last
        enough = [b - a for a in range(9) for b in range(a, 9) if share[a, b] >= 0.9]
        assert share[low[i], high[i]] >= 0.9
        assert high[i] - low[i] == min(enough)


def test_many_vehicles_have_the_bounds_of_a_normal_distribution_that_few_go_over_to():
    n = np.array([2850, 2950])  # of which 28.8 and 29.8 are likely to be missing
    few, many = volume_bounds(counted(n, observed=0.99, range_m=0.0), Confidence(hiding_deviation=0.0))

    assert np.diff(few)[0] == pytest.approx(100, abs=2)
    assert np.diff(many)[0] == pytest.approx(101, abs=2)


def test_percentiles_of_cells_are_those_of_numpy(rng):
    values, cell = rng.uniform(0, 40, 300), rng.integers(0, 12, 300)
    values[cell == 3] = 7.5

    found = percentile(values, cell, 14, 0.85)

    assert found[:12] == pytest.approx([np.quantile(values[cell == k], 0.85) for k in range(12)])
    assert np.isnan(found[12:]).all()
