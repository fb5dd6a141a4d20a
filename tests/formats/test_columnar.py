from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from service.errors import InvalidFrame
from service.formats.columnar import content_digest, decode_frame, encode_frame
from service.tracking.model import Frame

F32 = st.floats(width=32)
INT64 = st.integers(-(2**63), 2**63 - 1)


@st.composite
def frames(draw: st.DrawFn) -> Frame:
    n = draw(st.integers(0, 6))
    columns = [draw(hnp.arrays(np.float32, n, elements=F32)) for _ in range(4)]
    return Frame(
        draw(st.from_regex(r"[A-Za-z0-9_-]{1,64}", fullmatch=True)),
        draw(INT64),
        draw(st.none() | INT64),
        draw(st.none() | st.text(max_size=20)),
        *columns,
    )


def assert_equal_to_the_bit(left: Frame, right: Frame) -> None:
    for name in ("sensor_id", "time_us", "sequence", "boot_id"):
        assert getattr(left, name) == getattr(right, name)
    for name in ("range_m", "azimuth_rad", "radial_velocity_mps", "snr_db"):
        one, other = getattr(left, name), getattr(right, name)
        assert one.dtype == other.dtype == np.float32
        assert one.tobytes() == other.tobytes()


def simple_frame(**changes: object) -> Frame:
    column = np.arange(3, dtype=np.float32)
    values = {"sensor_id": "radar-1", "time_us": 5, "sequence": 1, "boot_id": None}
    return Frame(
        **(values | changes), range_m=column, azimuth_rad=column, radial_velocity_mps=column, snr_db=column
    )


@given(frames())
def test_a_frame_comes_back_to_the_bit(frame):
    assert_equal_to_the_bit(decode_frame(encode_frame(frame)), frame)


@given(frames())
def test_the_columns_of_a_decoded_frame_are_aligned_and_contiguous(frame):
    decoded = decode_frame(encode_frame(frame))

    assert decoded.snr_db.flags.c_contiguous
    assert decoded.snr_db.flags.aligned


def test_a_missing_number_differs_from_the_number_zero():
    numbered, unnumbered = simple_frame(sequence=0), simple_frame(sequence=None)

    assert decode_frame(encode_frame(unnumbered)).sequence is None
    assert content_digest(numbered) != content_digest(unnumbered)


def test_the_digest_depends_on_content_only():
    assert content_digest(simple_frame()) == content_digest(decode_frame(encode_frame(simple_frame())))
    assert content_digest(simple_frame()) != content_digest(simple_frame(time_us=6))


@pytest.mark.parametrize("keep", [0, 10, -1])
def test_truncated_bytes_are_refused(keep):
    with pytest.raises(InvalidFrame):
        decode_frame(encode_frame(simple_frame())[:keep])


def test_a_boot_id_that_does_not_fit_is_named():
    with pytest.raises(InvalidFrame, match="/boot_id"):
        encode_frame(simple_frame(boot_id="b" * 256))


def test_a_sequence_number_beyond_64_bits_is_refused():
    with pytest.raises(InvalidFrame, match="64 bits"):
        encode_frame(simple_frame(sequence=2**63))
