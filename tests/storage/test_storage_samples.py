import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.errors import StorageError
from service.storage.rows import STATE_SAMPLE
from service.storage.samples import pack, unpack, unpack_array


@given(st.integers(0, 60).flatmap(lambda n: st.binary(min_size=26 * n, max_size=26 * n)))
def test_any_samples_come_back_to_the_bit(samples):
    assert unpack(pack(samples)) == samples


def test_the_samples_of_a_second_take_less_than_their_26_bytes(block):
    samples = block().samples

    assert len(pack(samples)) < 22 * len(samples) // STATE_SAMPLE.itemsize


def test_unpacked_samples_are_an_array_of_the_columns(block):
    samples = unpack_array(pack(block(number=7, count=3).samples))

    assert samples["time_offset_ms"].tolist() == [0, 50, 100]
    assert samples["x_m"].tolist() == np.array([7, 7.01, 7.02], np.float32).tolist()


@pytest.mark.parametrize("size", [1, 25, 27])
def test_bytes_that_are_no_samples_are_refused(size):
    with pytest.raises(StorageError, match=f"{size} bytes"):
        pack(bytes(size))


def test_a_damaged_block_is_an_error_of_storage(block):
    stored = pack(block().samples)

    for damaged in (b"", stored[:1], stored[:300], stored[:-4], stored[:402] + b"\xff" + stored[403:]):
        with pytest.raises(StorageError, match="damaged"):
            unpack(damaged)
