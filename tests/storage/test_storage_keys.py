import hashlib

import pytest
from sqlalchemy import text

from service.errors import InvalidInput, NotFound
from service.storage.database import connection, session_scope
from service.storage.keys import create_key, find_key, list_keys, note_use, read_key, revoke_key

NOW_US = 1_800_000_000_000_000
MINUTE_US = 60_000_000


@pytest.fixture
def write(engine):
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


def test_the_secret_finds_its_key_and_is_not_stored(engine, write, read):
    key, secret = write(create_key, name="wall", scopes=["read", "admin"])
    other, other_secret = write(create_key, name="wall", scopes=["read"])

    assert read(find_key, secret) == key
    assert read(find_key, other_secret) == other
    assert key.scopes == {"read", "admin"}
    assert len(secret) == 43  # 32 bytes in base64
    with connection(engine) as reader:
        rows = reader.execute(text("SELECT * FROM api_keys")).mappings().all()
    assert {bytes(row["digest"]) for row in rows} == {
        hashlib.sha256(word.encode()).digest() for word in (secret, other_secret)
    }
    assert secret not in repr(rows)


@pytest.mark.parametrize("secret", ["", "wrong", "é" * 40, "\0", "x" * 10_000])
def test_another_secret_finds_nothing(write, read, secret):
    write(create_key, name="wall", scopes=["read"])

    assert read(find_key, secret) is None


def test_a_revoked_key_opens_nothing_and_stays_on_record(write, read):
    key, secret = write(create_key, name="wall", scopes=["read"])

    assert write(revoke_key, key.key_id).revoked_us == NOW_US
    assert write(revoke_key, key.key_id, now_us=NOW_US + 1).revoked_us == NOW_US

    assert read(find_key, secret) is None
    assert read(list_keys).items == ()
    assert [k.key_id for k in read(list_keys, include_revoked=True).items] == [key.key_id]
    assert read(read_key, key.key_id).revoked_us == NOW_US


def test_an_ingest_key_is_bound_to_its_sensors(write, read, sensor):
    bound, secret = write(create_key, name="mast", scopes=["ingest"], sensor_ids=[sensor])
    free, _ = write(create_key, name="all", scopes=["ingest"])
    reader, _ = write(create_key, name="wall", scopes=["read"])

    assert read(find_key, secret).sensor_ids == {sensor}
    assert [key.may_ingest(sensor) for key in (bound, free, reader)] == [True, True, False]
    assert [key.may_ingest("radar-2") for key in (bound, free, reader)] == [False, True, False]


@pytest.mark.parametrize(
    ("scopes", "sensor_ids", "pointer"),
    [
        ([], None, "/scopes"),
        (["write"], None, "/scopes"),
        (["read", "root"], None, "/scopes"),
        (["read"], ["radar-1"], "/sensor_ids"),
        (["ingest"], [], "/sensor_ids"),
        (["ingest"], ["radar-1", "radar-9"], "/sensor_ids"),
    ],
)
def test_a_key_that_makes_no_sense_is_refused(write, sensor, scopes, sensor_ids, pointer):
    with pytest.raises(InvalidInput) as caught:
        write(create_key, name="x", scopes=scopes, sensor_ids=sensor_ids)

    assert caught.value.errors[0].pointer == pointer


def test_use_is_noted_once_a_minute(write, read):
    key, _ = write(create_key, name="wall", scopes=["read"])
    noted = []
    for later_us in (0, MINUTE_US - 1, MINUTE_US, MINUTE_US + 5):
        write(note_use, key.key_id, now_us=NOW_US + later_us)
        noted.append(read(read_key, key.key_id).last_used_us - NOW_US)

    assert noted == [0, 0, MINUTE_US, MINUTE_US]


def test_keys_are_listed_as_they_were_made_in_pages(write, read):
    made = [write(create_key, name=str(n), scopes=["read"], now_us=NOW_US + n // 2)[0] for n in range(5)]

    first = read(list_keys, limit=3)
    second = read(list_keys, limit=3, cursor=first.next_cursor)

    assert first.items + second.items == tuple(sorted(made, key=lambda key: (key.created_us, key.key_id)))
    assert second.next_cursor is None


def test_an_unknown_key_is_not_found(write, read):
    with pytest.raises(NotFound):
        read(read_key, "nothing")
    with pytest.raises(NotFound):
        write(revoke_key, "nothing")
