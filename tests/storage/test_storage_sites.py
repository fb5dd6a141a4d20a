import pytest

from service.errors import Conflict, InvalidInput, NotFound
from service.formats.sensor import SensorConfig
from service.storage.database import connection, session_scope
from service.storage.sites import (
    archive_sensor,
    archive_site,
    create_sensor,
    create_site,
    list_sensors,
    list_sites,
    read_sensor,
    read_site,
    update_sensor,
    update_site,
)

NOW_US = 1_800_000_000_000_000
PLACE = {"name": "Bridge", "latitude_deg": 52.5, "longitude_deg": 13.4}


@pytest.fixture
def write(engine):
    """Return a function that runs one storage function in a transaction of its own."""

    def run(function, *args, **kwargs):
        with session_scope(engine) as writer:
            return function(writer, *args, now_us=kwargs.pop("now_us", NOW_US), **kwargs)

    return run


@pytest.fixture
def read(engine):
    def run(function, *args, **kwargs):
        with connection(engine) as reader:
            return function(reader, *args, **kwargs)

    return run


def test_a_site_comes_back_as_created_and_as_changed(write, read):
    created = write(create_site, "b1", **PLACE)
    changed = write(
        update_site, "b1", {"name": "Old bridge", "time_zone": "Europe/Berlin"}, now_us=NOW_US + 5
    )

    assert (created.name, created.time_zone, created.created_us) == ("Bridge", "UTC", NOW_US)
    assert (changed.name, changed.time_zone, changed.updated_us) == (
        "Old bridge",
        "Europe/Berlin",
        NOW_US + 5,
    )
    assert changed.latitude_deg == created.latitude_deg == 52.5
    assert read(read_site, "b1") == changed


def test_an_archived_site_disappears_and_keeps_its_id(write, read):
    write(create_site, "b1", **PLACE)
    write(archive_site, "b1")

    assert read(list_sites).items == ()
    assert [site.archived_us for site in read(list_sites, include_archived=True).items] == [NOW_US]
    with pytest.raises(NotFound):
        read(read_site, "b1")
    with pytest.raises(NotFound):
        write(update_site, "b1", {"name": "x"})
    with pytest.raises(NotFound):
        write(archive_site, "b1")
    with pytest.raises(Conflict):
        write(create_site, "b1", **PLACE)


def test_a_site_with_sensors_is_not_archived(write):
    write(create_site, "b1", **PLACE)
    write(create_sensor, SensorConfig(sensor_id="r1"), site_id="b1")

    with pytest.raises(Conflict, match="still has sensors"):
        write(archive_site, "b1")

    write(archive_sensor, "r1")
    write(archive_site, "b1")


def test_a_sensor_keeps_its_whole_configuration(write, read):
    config = SensorConfig.model_validate(
        {
            "sensor_id": "r1",
            "heading_deg": 12.5,
            "count_lines": [{"line_id": "a", "p0": [0, 50], "p1": [10, 50]}],
            "parameters": {"clustering.window_frames": "6"},
        }
    )
    created = write(create_sensor, config, name="North")

    assert read(read_sensor, "r1") == created
    assert (created.config, created.name, created.revision, created.site_id) == (config, "North", 1, None)


def test_each_change_of_a_sensor_raises_its_revision(write):
    write(create_site, "b1", **PLACE)
    config = SensorConfig(sensor_id="r1")
    write(create_sensor, config)

    moved = write(update_sensor, "r1", {"site_id": "b1"})
    turned = write(
        update_sensor, "r1", {"config": config.model_copy(update={"heading_deg": 90.0})}, now_us=NOW_US + 1
    )
    alone = write(update_sensor, "r1", {"site_id": None, "name": "x"})

    assert [(s.revision, s.site_id, s.name) for s in (moved, turned, alone)] == [
        (2, "b1", "r1"),
        (3, "b1", "r1"),
        (4, None, "x"),
    ]
    assert (turned.config.heading_deg, turned.updated_us) == (90.0, NOW_US + 1)


def test_a_sensor_is_refused_where_it_does_not_fit(write):
    write(create_sensor, SensorConfig(sensor_id="r1"))

    with pytest.raises(Conflict, match="r1"):
        write(create_sensor, SensorConfig(sensor_id="r1"))
    for changes in ({"site_id": "nowhere"}, {"config": SensorConfig(sensor_id="r2")}):
        with pytest.raises(InvalidInput) as caught:
            write(update_sensor, "r1", changes)
        assert caught.value.errors[0].pointer in {"/site_id", "/sensor_id"}
    with pytest.raises(InvalidInput, match="nowhere"):
        write(create_sensor, SensorConfig(sensor_id="r3"), site_id="nowhere")


def test_the_id_of_an_archived_sensor_is_not_given_again(write, read):
    write(create_sensor, SensorConfig(sensor_id="r1"))
    write(archive_sensor, "r1")

    assert read(list_sensors).items == ()
    assert read(read_sensor, "r1", include_archived=True).archived_us == NOW_US
    with pytest.raises(NotFound):
        read(read_sensor, "r1")
    with pytest.raises(NotFound):
        write(update_sensor, "r1", {"name": "x"})
    with pytest.raises(Conflict, match="not given again"):
        write(create_sensor, SensorConfig(sensor_id="r1"))


def test_sites_and_sensors_are_listed_by_id_in_pages(write, read):
    for letter in "dbca":
        write(create_site, letter, **PLACE)
        write(create_sensor, SensorConfig(sensor_id=f"r-{letter}"), site_id=letter)

    for function, names in (
        (list_sites, lambda page: [site.site_id for site in page.items]),
        (list_sensors, lambda page: [sensor.sensor_id[-1] for sensor in page.items]),
    ):
        first = read(function, limit=3)
        second = read(function, limit=3, cursor=first.next_cursor)
        assert (names(first), names(second), second.next_cursor) == (["a", "b", "c"], ["d"], None)
    assert [sensor.sensor_id for sensor in read(list_sensors, site_id="c").items] == ["r-c"]
