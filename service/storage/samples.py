"""Pack the samples of a state block into the bytes that the database keeps, and back, without loss.

The measured numbers of a sample (position, velocity, deviations: 20 of its 26 bytes) are noise to a
compressor and stay as they are; lane, status and the two offsets hardly change from one sample to the next,
so that their differences deflate to almost nothing. Layout: number of samples (u2, little-endian), the
measured bytes, the deflated rest.
"""

from __future__ import annotations

import struct
import zlib

import numpy as np
from numpy.typing import NDArray

from service.errors import StorageError
from service.storage.rows import STATE_SAMPLE

_COUNT = struct.Struct("<H")
_SIZE = STATE_SAMPLE.itemsize
_SPLIT = int(STATE_SAMPLE.fields["lane"][1]) if STATE_SAMPLE.fields else 0  # ... and bytes before this offset
_WINDOW_BITS = -9  # raw deflate with the smallest window: a block's rest is about a hundred bytes
_MEMORY_LEVEL = 1  # likewise; setting up a larger one costs more than the compression


def pack(samples: bytes) -> bytes:
    """Return the stored form of an array of STATE_SAMPLE."""
    if len(samples) % _SIZE or len(samples) // _SIZE > np.iinfo(np.uint16).max:
        raise StorageError(f"a block of {len(samples)} bytes is no array of {_SIZE}-byte samples")
    table = np.frombuffer(samples, np.uint8).reshape(-1, _SIZE)
    rest = table[:, _SPLIT:]
    steps = rest.copy()
    steps[1:] -= rest[:-1]  # modulo 256, as the sum in unpack_array
    deflate = zlib.compressobj(1, zlib.DEFLATED, _WINDOW_BITS, _MEMORY_LEVEL)
    return b"".join(
        (
            _COUNT.pack(len(table)),
            table[:, :_SPLIT].tobytes(),
            deflate.compress(steps.T.tobytes()),
            deflate.flush(),
        )
    )


def unpack(stored: bytes) -> bytes:
    """Return the array of STATE_SAMPLE, as bytes, that `pack` was given; raises StorageError when damaged."""
    return unpack_array(stored).tobytes()


def unpack_array(stored: bytes) -> NDArray[np.void]:
    """Return the samples (N,) as an array of STATE_SAMPLE."""
    try:
        (count,) = _COUNT.unpack_from(stored)
        split = _COUNT.size + count * _SPLIT
        rest = zlib.decompress(stored[split:], _WINDOW_BITS)
        table = np.empty((count, _SIZE), np.uint8)
        table[:, :_SPLIT] = np.frombuffer(stored[_COUNT.size : split], np.uint8).reshape(count, _SPLIT)
        steps = np.frombuffer(rest, np.uint8).reshape(_SIZE - _SPLIT, count)
    except (struct.error, zlib.error, ValueError) as error:
        raise StorageError(f"a stored block of {len(stored)} bytes is damaged: {error}") from error
    table[:, _SPLIT:] = np.cumsum(steps, axis=1, dtype=np.uint8).T
    return table.reshape(-1).view(STATE_SAMPLE)
