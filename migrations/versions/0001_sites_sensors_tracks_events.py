"""Sites, sensors, keys; tracks, their states, events; epochs, cursors and snapshots.

Revision: 0001, the first
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None


def upgrade() -> None:
    create_configuration()
    create_shards()
    create_tracks()
    create_track_states()
    create_events()


def downgrade() -> None:
    for table in ("events", "track_states", "tracks", "snapshots", "shards", "api_keys", "sensors", "sites"):
        op.drop_table(table)


def create_configuration() -> None:
    op.create_table(
        "sites",
        sa.Column("site_id", sa.Text(), nullable=False),
        sa.Column("name", sa.Text(), nullable=False),
        sa.Column("latitude_deg", sa.Double(), nullable=False),
        sa.Column("longitude_deg", sa.Double(), nullable=False),
        sa.Column("time_zone", sa.Text(), nullable=False),
        sa.Column("created_us", sa.BigInteger(), nullable=False),
        sa.Column("updated_us", sa.BigInteger(), nullable=False),
        sa.Column("archived_us", sa.BigInteger(), nullable=True),
        sa.PrimaryKeyConstraint("site_id", name=op.f("pk_sites")),
    )
    op.create_table(
        "sensors",
        sa.Column("ordinal", sa.Integer(), nullable=False),
        sa.Column("sensor_id", sa.Text(), nullable=False),
        sa.Column("site_id", sa.Text(), nullable=True),
        sa.Column("name", sa.Text(), nullable=False),
        sa.Column("config", sa.Text(), nullable=False),
        sa.Column("revision", sa.Integer(), nullable=False),
        sa.Column("created_us", sa.BigInteger(), nullable=False),
        sa.Column("updated_us", sa.BigInteger(), nullable=False),
        sa.Column("archived_us", sa.BigInteger(), nullable=True),
        sa.Column("longest_track_us", sa.BigInteger(), nullable=False),
        sa.ForeignKeyConstraint(["site_id"], ["sites.site_id"], name=op.f("fk_sensors_site_id")),
        sa.PrimaryKeyConstraint("ordinal", name=op.f("pk_sensors")),
        sa.UniqueConstraint("sensor_id", name=op.f("uq_sensors_sensor_id")),
    )
    op.create_table(
        "api_keys",
        sa.Column("key_id", sa.Text(), nullable=False),
        sa.Column("name", sa.Text(), nullable=False),
        sa.Column("digest", sa.LargeBinary(), nullable=False),
        sa.Column("scopes", sa.JSON(), nullable=False),
        sa.Column("sensor_ids", sa.JSON(none_as_null=True), nullable=True),
        sa.Column("created_us", sa.BigInteger(), nullable=False),
        sa.Column("revoked_us", sa.BigInteger(), nullable=True),
        sa.Column("last_used_us", sa.BigInteger(), nullable=True),
        sa.PrimaryKeyConstraint("key_id", name=op.f("pk_api_keys")),
        sa.UniqueConstraint("digest", name=op.f("uq_api_keys_digest")),
    )


def create_shards() -> None:
    op.create_table(
        "shards",
        sa.Column("sensor", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("epoch", sa.Integer(), nullable=False),
        sa.Column("epoch_first_position", sa.BigInteger(), nullable=False),
        sa.Column("cursor", sa.BigInteger(), nullable=False),
        sa.CheckConstraint("epoch >= 1", name=op.f("ck_shards_epoch")),
        sa.ForeignKeyConstraint(["sensor"], ["sensors.ordinal"], name=op.f("fk_shards_sensor")),
        sa.PrimaryKeyConstraint("sensor", name=op.f("pk_shards")),
    )
    op.create_table(
        "snapshots",
        sa.Column("sensor", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("epoch", sa.Integer(), nullable=False),
        sa.Column("position", sa.BigInteger(), nullable=False),
        sa.Column("state", sa.LargeBinary(), nullable=False),
        sa.Column("stored_us", sa.BigInteger(), nullable=False),
        sa.ForeignKeyConstraint(["sensor"], ["sensors.ordinal"], name=op.f("fk_snapshots_sensor")),
        sa.PrimaryKeyConstraint("sensor", name=op.f("pk_snapshots")),
    )


def create_tracks() -> None:
    op.create_table(
        "tracks",
        sa.Column("sensor", sa.Integer(), nullable=False),
        sa.Column("epoch", sa.Integer(), nullable=False),
        sa.Column("number", sa.BigInteger(), nullable=False),
        sa.Column("as_of", sa.BigInteger(), nullable=False),
        sa.Column("ended", sa.Boolean(), nullable=False),
        sa.Column("first_time_us", sa.BigInteger(), nullable=False),
        sa.Column("last_time_us", sa.BigInteger(), nullable=False),
        sa.Column("first_frame", sa.BigInteger(), nullable=False),
        sa.Column("last_frame", sa.BigInteger(), nullable=False),
        sa.Column("states", sa.Integer(), nullable=False),
        sa.Column("hits", sa.Integer(), nullable=False),
        sa.Column("length_m", sa.Double(), nullable=True),
        sa.Column("width_m", sa.Double(), nullable=True),
        sa.Column("length_class", sa.Text(), nullable=True),
        sa.Column("existence", sa.Double(), nullable=False),
        sa.Column("first_x_m", sa.Double(), nullable=False),
        sa.Column("first_y_m", sa.Double(), nullable=False),
        sa.Column("last_x_m", sa.Double(), nullable=False),
        sa.Column("last_y_m", sa.Double(), nullable=False),
        sa.Column("distance_m", sa.Double(), nullable=False),
        sa.Column("mean_speed_mps", sa.Double(), nullable=False),
        sa.Column("max_speed_mps", sa.Double(), nullable=False),
        sa.Column("stored_day", sa.Integer(), nullable=False),
        sa.ForeignKeyConstraint(["sensor"], ["sensors.ordinal"], name=op.f("fk_tracks_sensor")),
        sa.PrimaryKeyConstraint("sensor", "epoch", "number", name=op.f("pk_tracks")),
    )
    op.create_index("ix_tracks_by_sensor", "tracks", ["sensor", "first_time_us", "epoch", "number"])
    op.create_index("ix_tracks_by_time", "tracks", ["first_time_us", "sensor", "epoch", "number"])
    op.create_index("ix_tracks_stored_day", "tracks", ["stored_day"])


def create_track_states() -> None:
    op.create_table(
        "track_states",
        sa.Column("sensor", sa.Integer(), nullable=False),
        sa.Column("second", sa.BigInteger(), nullable=False),
        sa.Column("epoch", sa.Integer(), nullable=False),
        sa.Column("number", sa.BigInteger(), nullable=False),
        sa.Column("first_frame", sa.BigInteger(), nullable=False),
        sa.Column("stored_day", sa.Integer(), nullable=False),
        sa.Column("samples", sa.LargeBinary(), nullable=False),
        sa.PrimaryKeyConstraint("sensor", "second", "epoch", "number", name=op.f("pk_track_states")),
        postgresql_partition_by="RANGE (second)",
    )
    op.create_index("ix_track_states_stored_day", "track_states", ["stored_day"])
    if op.get_context().dialect.name == "postgresql":
        op.execute("CREATE TABLE track_states_default PARTITION OF track_states DEFAULT")


def create_events() -> None:
    op.create_table(
        "events",
        sa.Column("sensor", sa.Integer(), nullable=False),
        sa.Column("epoch", sa.Integer(), nullable=False),
        sa.Column("number", sa.BigInteger(), nullable=False),
        sa.Column("as_of", sa.BigInteger(), nullable=False),
        sa.Column("kind", sa.Text(), nullable=False),
        sa.Column("time_us", sa.BigInteger(), nullable=False),
        sa.Column("detail", sa.JSON(), nullable=False),
        sa.Column("stored_day", sa.Integer(), nullable=False),
        sa.ForeignKeyConstraint(["sensor"], ["sensors.ordinal"], name=op.f("fk_events_sensor")),
        sa.PrimaryKeyConstraint("sensor", "epoch", "number", name=op.f("pk_events")),
    )
    op.create_index("ix_events_by_sensor", "events", ["sensor", "time_us", "epoch", "number"])
    op.create_index("ix_events_stored_day", "events", ["stored_day"])
