"""Crossings, frames received and Edie's sums by minute; counts by hand."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "crossing_blocks",
        sa.Column("sensor", sa.Integer(), nullable=False),
        sa.Column("minute", sa.BigInteger(), nullable=False),
        sa.Column("line_id", sa.Text(), nullable=False),
        sa.Column("epoch", sa.Integer(), nullable=False),
        sa.Column("part", sa.BigInteger(), nullable=False),
        sa.Column("as_of", sa.BigInteger(), nullable=False),
        sa.Column("stored_day", sa.Integer(), nullable=False),
        sa.Column("records", sa.LargeBinary(), nullable=False),
        sa.PrimaryKeyConstraint(
            "sensor", "minute", "line_id", "epoch", "part", name=op.f("pk_crossing_blocks")
        ),
    )
    op.create_table(
        "traffic_minutes",
        sa.Column("sensor", sa.Integer(), nullable=False),
        sa.Column("minute", sa.BigInteger(), nullable=False),
        sa.Column("epoch", sa.Integer(), nullable=False),
        sa.Column("as_of", sa.BigInteger(), nullable=False),
        sa.Column("frames", sa.Integer(), nullable=False),
        sa.Column("expected", sa.Integer(), nullable=False),
        sa.Column("observed_us", sa.Integer(), nullable=False),
        sa.Column("stored_day", sa.Integer(), nullable=False),
        sa.PrimaryKeyConstraint("sensor", "minute", "epoch", name=op.f("pk_traffic_minutes")),
    )
    op.create_table(
        "cell_minutes",
        sa.Column("sensor", sa.Integer(), nullable=False),
        sa.Column("minute", sa.BigInteger(), nullable=False),
        sa.Column("epoch", sa.Integer(), nullable=False),
        sa.Column("map_version", sa.Integer(), nullable=False),
        sa.Column("as_of", sa.BigInteger(), nullable=False),
        sa.Column("stored_day", sa.Integer(), nullable=False),
        sa.Column("cells", sa.LargeBinary(), nullable=False),
        sa.PrimaryKeyConstraint("sensor", "minute", "epoch", "map_version", name=op.f("pk_cell_minutes")),
    )
    for table in ("crossing_blocks", "traffic_minutes", "cell_minutes"):
        op.create_index(f"ix_{table}_stored_day", table, ["stored_day"])
    _create_manual_counts()


def _create_manual_counts() -> None:
    op.create_table(
        "manual_counts",
        sa.Column("sensor", sa.Integer(), nullable=False),
        sa.Column("start_us", sa.BigInteger(), nullable=False),
        sa.Column("interval_s", sa.Integer(), nullable=False),
        sa.Column("line_id", sa.Text(), nullable=False),
        sa.Column("lane", sa.Integer(), nullable=False),
        sa.Column("direction", sa.Integer(), nullable=False),
        sa.Column("length_class", sa.Text(), nullable=False),
        sa.Column("counted", sa.Integer(), nullable=False),
        sa.Column("updated_us", sa.BigInteger(), nullable=False),
        sa.ForeignKeyConstraint(["sensor"], ["sensors.ordinal"], name=op.f("fk_manual_counts_sensor")),
        sa.PrimaryKeyConstraint(
            "sensor", "start_us", "interval_s", "line_id", "lane", "direction", "length_class",
            name=op.f("pk_manual_counts"),
        ),
    )  # fmt: skip


def downgrade() -> None:
    for table in ("manual_counts", "cell_minutes", "traffic_minutes", "crossing_blocks"):
        op.drop_table(table)
