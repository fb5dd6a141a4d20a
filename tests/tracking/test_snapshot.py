from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, TypeVar

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray
from typing_extensions import TypeAliasType

from service.errors import SnapshotUnreadable
from service.tracking import snapshot


class Colour(IntEnum):
    RED = 1
    BLUE = 2


@dataclass(frozen=True, slots=True)
class Inner:
    mean: NDArray[np.float64]
    seen: NDArray[np.bool_]
    name: str


@dataclass(frozen=True, slots=True)
class Outer:
    count: int
    rate: float
    ready: bool
    colour: Colour
    label: str | None
    raw: bytes
    inner: Inner
    history: tuple[Inner, ...]
    pair: tuple[int, str]
    numbers: NDArray[np.int64]
    last: Inner | None = None


@dataclass(frozen=True, slots=True)
class OuterRenamed:
    counted: int


@dataclass(frozen=True, slots=True)
class Untypable:
    anything: dict[str, int]


Scalar = TypeVar("Scalar", bound=np.generic)
Row = TypeAliasType("Row", np.ndarray[Any, np.dtype[Scalar]], type_params=(Scalar,))


@dataclass(frozen=True, slots=True)
class Aliased:
    row: Row[np.float32]  # as numpy spells NDArray from Python 3.12 on


ARRAYS = hnp.arrays(
    np.float64,
    hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4),
    elements=st.floats(allow_nan=True, allow_infinity=True),
)
FLAGS = hnp.arrays(np.bool_, hnp.array_shapes(max_dims=2, min_side=0, max_side=5))
INNER = st.builds(Inner, ARRAYS, FLAGS, st.text(max_size=5))
INT64 = st.integers(-(2**63), 2**63 - 1)
OUTER = st.builds(
    Outer,
    count=INT64,
    rate=st.floats(allow_nan=False),
    ready=st.booleans(),
    colour=st.sampled_from(Colour),
    label=st.none() | st.text(max_size=5),
    raw=st.binary(max_size=5),
    inner=INNER,
    history=st.lists(INNER, max_size=3).map(tuple),
    pair=st.tuples(INT64, st.text(max_size=3)),
    numbers=hnp.arrays(np.int64, st.integers(0, 5)),
    last=st.none() | INNER,
)


def example() -> Outer:
    inner = Inner(np.arange(6.0).reshape(2, 3), np.array([True, False]), "a")
    return Outer(
        7,
        0.5,
        True,
        Colour.BLUE,
        None,
        b"\x00\xff",
        inner,
        (inner,),
        (1, "x"),
        np.array([1, 2], dtype=np.int64),
    )


def assert_same(left: object, right: object) -> None:
    assert type(left) is type(right)
    if dataclasses.is_dataclass(left):
        for field in dataclasses.fields(left):
            assert_same(getattr(left, field.name), getattr(right, field.name))
    elif isinstance(left, np.ndarray):
        assert isinstance(right, np.ndarray)
        assert (left.dtype, left.shape, left.tobytes()) == (right.dtype, right.shape, right.tobytes())
    elif isinstance(left, tuple):
        assert isinstance(right, tuple)
        assert len(left) == len(right)
        for one, other in zip(left, right, strict=True):
            assert_same(one, other)
    else:
        assert left == right


@given(OUTER)
def test_a_state_comes_back_to_the_bit_and_gives_the_same_bytes_again(state):
    data = snapshot.dump(state)

    restored = snapshot.load(Outer, data)

    assert_same(restored, state)
    assert snapshot.dump(restored) == data


def test_the_memory_order_of_an_array_is_kept_and_the_copy_is_writable():
    fortran = np.asfortranarray(np.arange(6.0).reshape(2, 3))
    state = Inner(fortran, np.zeros(1, dtype=np.bool_), "f")

    restored = snapshot.load(Inner, snapshot.dump(state))

    assert restored.mean.flags.f_contiguous
    assert not restored.mean.flags.c_contiguous
    assert restored.mean.flags.writeable
    assert restored.mean.flags.aligned
    np.testing.assert_array_equal(restored.mean, fortran)


@given(st.data())
def test_one_changed_or_missing_byte_is_noticed(data):
    good = snapshot.dump(example())
    at = data.draw(st.integers(0, len(good) - 1))
    changed = bytearray(good)
    changed[at] ^= data.draw(st.integers(1, 255))

    with pytest.raises(SnapshotUnreadable):
        snapshot.load(Outer, bytes(changed))
    with pytest.raises(SnapshotUnreadable):
        snapshot.load(Outer, good[:at])


def test_a_state_of_another_schema_is_refused():
    with pytest.raises(SnapshotUnreadable, match="another OuterRenamed"):
        snapshot.load(OuterRenamed, snapshot.dump(example()))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"numbers": np.zeros(2)}, "Outer.numbers: want an array of int64, got float64"),
        ({"count": 1.5}, "Outer.count: want int"),
        ({"count": True}, "Outer.count: want int"),
        ({"ready": 1}, "Outer.ready: want bool"),
        ({"count": 2**63}, "Outer.count: want int"),
        ({"label": 3}, "Outer.label: want str"),
        ({"inner": 3}, "Outer.inner: want Inner"),
    ],
)
def test_a_value_that_does_not_fit_its_hint_is_named(change, message):
    with pytest.raises(TypeError, match=message):
        snapshot.dump(dataclasses.replace(example(), **change))


def test_an_array_may_be_hinted_by_an_alias():
    state = Aliased(np.arange(3, dtype=np.float32))

    restored = snapshot.load(Aliased, snapshot.dump(state))

    np.testing.assert_array_equal(restored.row, state.row)
    assert restored.row.dtype == np.float32


def test_a_type_without_a_codec_is_named():
    with pytest.raises(TypeError, match="no snapshot codec for dict"):
        snapshot.dump(Untypable({}))
