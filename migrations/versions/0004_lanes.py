"""Lane maps and lane changes.

Revision: 0004, after 0003
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "lane_maps",
        sa.Column("sensor", sa.Integer(), nullable=False),
        sa.Column("epoch", sa.Integer(), nullable=False),
        sa.Column("version", sa.Integer(), nullable=False),
        sa.Column("time_us", sa.BigInteger(), nullable=False),
        sa.Column("frame", sa.BigInteger(), nullable=False),
        sa.Column("vehicles", sa.Integer(), nullable=False),
        sa.Column("source", sa.Text(), nullable=False),
        sa.Column("lanes", sa.Text(), nullable=False),
        sa.ForeignKeyConstraint(["sensor"], ["sensors.ordinal"], name=op.f("fk_lane_maps_sensor")),
        sa.PrimaryKeyConstraint("sensor", "epoch", "version", name=op.f("pk_lane_maps")),
    )
    op.create_table(
        "lane_changes",
        sa.Column("sensor", sa.Integer(), nullable=False),
        sa.Column("epoch", sa.Integer(), nullable=False),
        sa.Column("number", sa.BigInteger(), nullable=False),
        sa.Column("decided_us", sa.BigInteger(), nullable=False),
        sa.Column("time_us", sa.BigInteger(), nullable=False),
        sa.Column("from_lane", sa.Integer(), nullable=False),
        sa.Column("to_lane", sa.Integer(), nullable=False),
        sa.Column("x_m", sa.Double(), nullable=False),
        sa.Column("y_m", sa.Double(), nullable=False),
        sa.Column("speed_mps", sa.Double(), nullable=False),
        sa.Column("map_version", sa.Integer(), nullable=False),
        sa.Column("stored_day", sa.Integer(), nullable=False),
        sa.ForeignKeyConstraint(["sensor"], ["sensors.ordinal"], name=op.f("fk_lane_changes_sensor")),
        sa.PrimaryKeyConstraint("sensor", "epoch", "number", "decided_us", name=op.f("pk_lane_changes")),
    )
    op.create_index(
        "ix_lane_changes_by_sensor", "lane_changes", ["sensor", "time_us", "epoch", "number", "decided_us"]
    )
    op.create_index("ix_lane_changes_stored_day", "lane_changes", ["stored_day"])


def downgrade() -> None:
    op.drop_table("lane_changes")
    op.drop_table("lane_maps")
