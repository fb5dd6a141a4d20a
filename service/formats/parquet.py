"""Write rows as Parquet, where pyarrow is installed (`pip install wayside[parquet]`)."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence

from service.errors import InvalidInput


def parquet_bytes(
    rows: Sequence[Mapping[str, object]], columns: Sequence[str], about: Mapping[str, str]
) -> bytes:
    """Return rows as one Parquet file, `about` in its metadata; raises InvalidInput without pyarrow.

    A column in which nothing is known in any row has type null.
    """
    try:
        import pyarrow as pa  # noqa: PLC0415 - an extra of 50 MB
        from pyarrow import parquet  # noqa: PLC0415
    except ImportError:
        raise InvalidInput.at("/format", "parquet needs the extra: pip install 'wayside[parquet]'") from None
    table = pa.table({name: [row.get(name) for row in rows] for name in columns})
    table = table.replace_schema_metadata({key: text.encode() for key, text in about.items()})
    out = io.BytesIO()
    parquet.write_table(table, out, compression="zstd")
    return out.getvalue()
