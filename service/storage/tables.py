"""The tables of the database, for SQLite and PostgreSQL alike (SQLAlchemy Core throughout).

Core also for the few rows of configuration: one way to read and write, no identity map, and functions that
return plain frozen values. Times are integers since 1970, UTC: microseconds (`_us`), whole seconds (`second`)
or days (`stored_day`, the host's clock when the row was first written: what retention counts from).
"""

from __future__ import annotations

from sqlalchemy import (
    JSON,
    BigInteger,
    Boolean,
    CheckConstraint,
    Column,
    Double,
    ForeignKey,
    Index,
    Integer,
    LargeBinary,
    MetaData,
    PrimaryKeyConstraint,
    Table,
    Text,
)

metadata = MetaData(
    naming_convention={
        "pk": "pk_%(table_name)s",
        "fk": "fk_%(table_name)s_%(column_0_name)s",
        "uq": "uq_%(table_name)s_%(column_0_name)s",
        "ck": "ck_%(table_name)s_%(constraint_name)s",
        "ix": "ix_%(table_name)s_%(column_0_name)s",
    }
)

sites = Table(
    "sites",
    metadata,
    Column("site_id", Text, primary_key=True),
    Column("name", Text, nullable=False),
    Column("latitude_deg", Double, nullable=False),
    Column("longitude_deg", Double, nullable=False),
    Column("time_zone", Text, nullable=False),
    Column("created_us", BigInteger, nullable=False),
    Column("updated_us", BigInteger, nullable=False),
    Column("archived_us", BigInteger),
)

sensors = Table(
    "sensors",
    metadata,
    Column("ordinal", Integer, primary_key=True),  # stands for the sensor in the large tables
    Column("sensor_id", Text, nullable=False, unique=True),
    Column("site_id", Text, ForeignKey("sites.site_id")),
    Column("name", Text, nullable=False),
    Column("config", Text, nullable=False),  # SensorConfig.canonical_json()
    Column("revision", Integer, nullable=False),
    Column("created_us", BigInteger, nullable=False),
    Column("updated_us", BigInteger, nullable=False),
    Column("archived_us", BigInteger),
    Column(
        "longest_track_us", BigInteger, nullable=False
    ),  # bounds how far back a window of tracks must look
)

api_keys = Table(
    "api_keys",
    metadata,
    Column("key_id", Text, primary_key=True),
    Column("name", Text, nullable=False),
    Column("digest", LargeBinary, nullable=False, unique=True),  # SHA-256 of the secret
    Column("scopes", JSON, nullable=False),
    Column("sensor_ids", JSON(none_as_null=True)),  # NULL: every sensor
    Column("created_us", BigInteger, nullable=False),
    Column("revoked_us", BigInteger),
    Column("last_used_us", BigInteger),
    Column("rotated_us", BigInteger),  # when the key got its present secret, NULL: at its creation
)

acts = Table(
    "acts",
    metadata,
    Column("number", Integer, primary_key=True),
    Column("time_us", BigInteger, nullable=False),
    Column("actor", Text, nullable=False),
    Column("action", Text, nullable=False),
    Column("target", Text, nullable=False),
    Column("detail", JSON, nullable=False),
)

kept_replies = Table(
    "kept_replies",
    metadata,
    Column("name", LargeBinary, primary_key=True),  # SHA-256 of caller, route and Idempotency-Key
    Column("request", LargeBinary, nullable=False),  # SHA-256 of the body
    Column("status", Integer, nullable=False),
    Column("headers", JSON, nullable=False),
    Column("body", LargeBinary),  # NULL: it held a secret
    Column("expires_us", BigInteger, nullable=False),
    Index("ix_kept_replies_expires_us", "expires_us"),
)

shards = Table(
    "shards",
    metadata,
    Column("sensor", Integer, ForeignKey("sensors.ordinal"), primary_key=True, autoincrement=False),
    Column("epoch", Integer, nullable=False),
    Column("epoch_first_position", BigInteger, nullable=False),
    Column("cursor", BigInteger, nullable=False),  # log position up to which every row is stored
    CheckConstraint("epoch >= 1", name="epoch"),
)

# Apart from `shards`: SQLite rewrites a whole row, and the cursor moves every second.
snapshots = Table(
    "snapshots",
    metadata,
    Column("sensor", Integer, ForeignKey("sensors.ordinal"), primary_key=True, autoincrement=False),
    Column("epoch", Integer, nullable=False),
    Column("position", BigInteger, nullable=False),
    Column("state", LargeBinary, nullable=False),
    Column("stored_us", BigInteger, nullable=False),
)

tracks = Table(
    "tracks",
    metadata,
    Column("sensor", Integer, ForeignKey("sensors.ordinal"), nullable=False),
    Column("epoch", Integer, nullable=False),
    Column("number", BigInteger, nullable=False),
    Column("as_of", BigInteger, nullable=False),
    Column("ended", Boolean, nullable=False),
    Column("first_time_us", BigInteger, nullable=False),
    Column("last_time_us", BigInteger, nullable=False),
    Column("first_frame", BigInteger, nullable=False),
    Column("last_frame", BigInteger, nullable=False),
    Column("states", Integer, nullable=False),
    Column("hits", Integer, nullable=False),
    Column("length_m", Double),
    Column("width_m", Double),
    Column("length_class", Text),
    Column("existence", Double, nullable=False),
    Column("first_x_m", Double, nullable=False),
    Column("first_y_m", Double, nullable=False),
    Column("last_x_m", Double, nullable=False),
    Column("last_y_m", Double, nullable=False),
    Column("distance_m", Double, nullable=False),
    Column("mean_speed_mps", Double, nullable=False),
    Column("max_speed_mps", Double, nullable=False),
    Column("stored_day", Integer, nullable=False),
    PrimaryKeyConstraint("sensor", "epoch", "number"),
    Index("ix_tracks_by_sensor", "sensor", "first_time_us", "epoch", "number"),
    Index("ix_tracks_by_time", "first_time_us", "sensor", "epoch", "number"),
    Index("ix_tracks_stored_day", "stored_day"),
)

# On SQLite a table in order of arrival with the key as an index beside it: smaller than one WITHOUT ROWID
# (24.4 against 25.5 to 26.6 bytes a state), and blocks that expire together lie together. No foreign key: the
# ordinal comes from `sensors` in the same transaction, and this is the busiest table.
track_states = Table(
    "track_states",
    metadata,
    Column("sensor", Integer, nullable=False),
    Column("second", BigInteger, nullable=False),
    Column("epoch", Integer, nullable=False),
    Column("number", BigInteger, nullable=False),
    Column("first_frame", BigInteger, nullable=False),
    Column("stored_day", Integer, nullable=False),
    Column("samples", LargeBinary, nullable=False),  # storage.samples.pack
    PrimaryKeyConstraint("sensor", "second", "epoch", "number"),
    Index("ix_track_states_stored_day", "stored_day"),
    postgresql_partition_by="RANGE (second)",
)

events = Table(
    "events",
    metadata,
    Column("sensor", Integer, ForeignKey("sensors.ordinal"), nullable=False),
    Column("epoch", Integer, nullable=False),
    Column("number", BigInteger, nullable=False),
    Column("as_of", BigInteger, nullable=False),
    Column("kind", Text, nullable=False),
    Column("time_us", BigInteger, nullable=False),
    Column("detail", JSON, nullable=False),
    Column("stored_day", Integer, nullable=False),
    PrimaryKeyConstraint("sensor", "epoch", "number"),
    Index("ix_events_by_sensor", "sensor", "time_us", "epoch", "number"),
    Index("ix_events_stored_day", "stored_day"),
)

# The crossings of a line and minute in one row: a day of a line is 1,440 rows, and a crossing takes 54
# bytes. No foreign key, for the reason given at track_states.
crossing_blocks = Table(
    "crossing_blocks",
    metadata,
    Column("sensor", Integer, nullable=False),
    Column("minute", BigInteger, nullable=False),  # since 1970
    Column("line_id", Text, nullable=False),
    Column("epoch", Integer, nullable=False),
    Column("part", BigInteger, nullable=False),
    Column("as_of", BigInteger, nullable=False),
    Column("stored_day", Integer, nullable=False),
    Column("records", LargeBinary, nullable=False),  # array of traffic.records.CROSSING
    PrimaryKeyConstraint("sensor", "minute", "line_id", "epoch", "part"),
    Index("ix_crossing_blocks_stored_day", "stored_day"),
)

traffic_minutes = Table(
    "traffic_minutes",
    metadata,
    Column("sensor", Integer, nullable=False),
    Column("minute", BigInteger, nullable=False),
    Column("epoch", Integer, nullable=False),
    Column("as_of", BigInteger, nullable=False),
    Column("frames", Integer, nullable=False),
    Column("expected", Integer, nullable=False),
    Column("observed_us", Integer, nullable=False),
    Column("stored_day", Integer, nullable=False),
    PrimaryKeyConstraint("sensor", "minute", "epoch"),
    Index("ix_traffic_minutes_stored_day", "stored_day"),
)

cell_minutes = Table(
    "cell_minutes",
    metadata,
    Column("sensor", Integer, nullable=False),
    Column("minute", BigInteger, nullable=False),
    Column("epoch", Integer, nullable=False),
    Column("map_version", Integer, nullable=False),
    Column("as_of", BigInteger, nullable=False),
    Column("stored_day", Integer, nullable=False),
    Column("cells", LargeBinary, nullable=False),  # array of traffic.cells.CELL
    PrimaryKeyConstraint("sensor", "minute", "epoch", "map_version"),
    Index("ix_cell_minutes_stored_day", "stored_day"),
)

# What people counted by hand; kept until it is replaced or deleted.
manual_counts = Table(
    "manual_counts",
    metadata,
    Column("sensor", Integer, ForeignKey("sensors.ordinal"), nullable=False),
    Column("start_us", BigInteger, nullable=False),
    Column("interval_s", Integer, nullable=False),
    Column("line_id", Text, nullable=False),
    Column("lane", Integer, nullable=False),  # 0: all lanes
    Column("direction", Integer, nullable=False),  # 0: both
    Column("length_class", Text, nullable=False),  # empty: all
    Column("counted", Integer, nullable=False),
    Column("updated_us", BigInteger, nullable=False),
    PrimaryKeyConstraint("sensor", "start_us", "interval_s", "line_id", "lane", "direction", "length_class"),
)

# The lanes of a sensor from a moment on. One stays as long as a count or a change names it.
lane_maps = Table(
    "lane_maps",
    metadata,
    Column("sensor", Integer, ForeignKey("sensors.ordinal"), nullable=False),
    Column("epoch", Integer, nullable=False),
    Column("version", Integer, nullable=False),
    Column("time_us", BigInteger, nullable=False),
    Column("frame", BigInteger, nullable=False),
    Column("vehicles", Integer, nullable=False),
    Column("source", Text, nullable=False),
    Column("lanes", Text, nullable=False),  # formats.lanes.lanes_json
    Column("stored_day", Integer, nullable=False),
    PrimaryKeyConstraint("sensor", "epoch", "version"),
    Index("ix_lane_maps_stored_day", "stored_day"),
)

lane_changes = Table(
    "lane_changes",
    metadata,
    Column("sensor", Integer, ForeignKey("sensors.ordinal"), nullable=False),
    Column("epoch", Integer, nullable=False),
    Column("number", BigInteger, nullable=False),
    Column("decided_us", BigInteger, nullable=False),
    Column("time_us", BigInteger, nullable=False),
    Column("from_lane", Integer, nullable=False),
    Column("to_lane", Integer, nullable=False),
    Column("x_m", Double, nullable=False),
    Column("y_m", Double, nullable=False),
    Column("speed_mps", Double, nullable=False),
    Column("map_version", Integer, nullable=False),
    Column("stored_day", Integer, nullable=False),
    PrimaryKeyConstraint("sensor", "epoch", "number", "decided_us"),
    Index("ix_lane_changes_by_sensor", "sensor", "time_us", "epoch", "number", "decided_us"),
    Index("ix_lane_changes_stored_day", "stored_day"),
)
