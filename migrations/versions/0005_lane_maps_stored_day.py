"""The day on which a lane map was stored, from which its retention counts.

Revision: 0005, after 0004
"""

from __future__ import annotations

import time

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"
branch_labels = None
depends_on = None

S_PER_DAY = 86_400


def upgrade() -> None:
    today = int(time.time()) // S_PER_DAY  # when older maps were stored is not known: their days begin now
    op.add_column("lane_maps", sa.Column("stored_day", sa.Integer(), nullable=True))
    op.execute(sa.text("UPDATE lane_maps SET stored_day = :today").bindparams(today=today))
    with op.batch_alter_table("lane_maps") as batch:
        batch.alter_column("stored_day", existing_type=sa.Integer(), nullable=False)
    op.create_index("ix_lane_maps_stored_day", "lane_maps", ["stored_day"])


def downgrade() -> None:
    op.drop_index("ix_lane_maps_stored_day", "lane_maps")
    with op.batch_alter_table("lane_maps") as batch:
        batch.drop_column("stored_day")
