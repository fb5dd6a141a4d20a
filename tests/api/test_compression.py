from __future__ import annotations

import gzip
import sys
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.api.compression import MEMBERS_MAX, inflate
from service.api.problems import HttpProblem

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

PACK = {"gzip": gzip.compress, "zstd": zstd.compress}
LIMIT = 1_000_000


def status_of(body, encoding, limit=LIMIT):
    with pytest.raises(HttpProblem) as caught:
        inflate(body, encoding, limit)
    return caught.value.kind.status


@pytest.mark.parametrize("encoding", PACK)
@given(first=st.binary(max_size=500), second=st.binary(max_size=500))
def test_several_members_are_one_body(encoding, first, second):
    packed = PACK[encoding](first) + PACK[encoding](second)

    assert inflate(packed, encoding, LIMIT) == first + second


@pytest.mark.parametrize("encoding", PACK)
def test_what_outgrows_the_limit_is_refused_and_what_fits_is_not(encoding):
    packed = PACK[encoding](bytes(LIMIT))

    assert len(inflate(packed, encoding, LIMIT)) == LIMIT
    assert status_of(packed, encoding, LIMIT - 1) == 413
    assert status_of(PACK[encoding](bytes(LIMIT // 2 + 1)) * 2, encoding) == 413


@pytest.mark.parametrize("encoding", PACK)
def test_a_bomb_is_stopped_at_the_limit(encoding):
    bomb = PACK[encoding](bytes(300_000_000))
    begun_s = time.process_time()

    assert status_of(bomb, encoding) == 413
    assert time.process_time() - begun_s < 0.2  # inflating all of it takes 0.3 s and more


@pytest.mark.parametrize("encoding", PACK)
def test_damaged_and_truncated_data_and_a_flood_of_members_are_refused(encoding):
    packed = PACK[encoding](b"0123456789" * 20)

    assert status_of(b"nothing of the kind", encoding) == 400
    assert status_of(packed[:-4], encoding) == 400
    assert status_of(packed + b"\0\0\0\0\0", encoding) == 400
    assert status_of(PACK[encoding](b"") * (MEMBERS_MAX + 1), encoding) == 400


def test_a_zstd_frame_cannot_ask_for_a_large_window():
    options = {zstd.CompressionParameter.window_log: 27, zstd.CompressionParameter.content_size_flag: 0}
    packer = zstd.ZstdCompressor(options=options)
    packed = packer.compress(b"x") + packer.flush()

    assert status_of(packed, "zstd") == 400
