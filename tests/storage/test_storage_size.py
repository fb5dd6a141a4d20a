import importlib.util
import sys
from pathlib import Path

import pytest

BENCHMARK = Path(__file__).parents[2] / "benchmarks" / "storage_size.py"


@pytest.fixture(scope="module")
def benchmark_module():
    spec = importlib.util.spec_from_file_location("storage_size", BENCHMARK)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
def test_a_stored_track_state_takes_at_most_thirty_bytes_of_the_file(benchmark_module, tmp_path):
    # without snapshots: one a sensor, however long it runs
    load = benchmark_module.Load(seconds=45, sensors=1, tracks=60, life_s=12.0, snapshot_bytes=0)

    result = benchmark_module.measure(tmp_path / "rows.sqlite", load)

    assert result.states == 45 * 20 * 60
    assert result.bytes_per_state <= benchmark_module.BAR_BYTES_PER_STATE
    assert result.file_bytes == (tmp_path / "rows.sqlite").stat().st_size


@pytest.mark.slow
def test_sensors_side_by_side_fill_the_pages_as_one_alone_does(benchmark_module, tmp_path):
    load = benchmark_module.Load(seconds=15, sensors=4, tracks=60, life_s=12.0, snapshot_bytes=0)

    result = benchmark_module.measure(tmp_path / "rows.sqlite", load)

    assert result.bytes_per_state <= benchmark_module.BAR_BYTES_PER_STATE
