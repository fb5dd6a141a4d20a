from __future__ import annotations

import httpx
import pytest

from service.api.security import Keyring, host_name, is_loopback
from service.api.server import refuse_open_network
from service.errors import InvalidInput
from service.settings import Settings
from service.storage.database import open_database, session_scope
from service.storage.keys import create_key
from service.storage.migrate import upgrade
from tests.api.serving import problem, recording, serving


@pytest.fixture(scope="module")
def locked(tmp_path_factory):
    """A service with an admin key, an ingest key bound to one of two sensors, and a read key."""
    with serving(tmp_path_factory.mktemp("locked")) as running:
        for sensor_id in ("mine", "other"):
            running.post("/sensors", json={"sensor_id": sensor_id})
        assert running.get("/session").json() == {
            "open": True,
            "key_id": None,
            "scopes": ["admin", "ingest", "read"],
        }
        keys = {}
        bodies = {
            "admin": {"name": "admin", "scopes": ["admin"]},
            "ingest": {"name": "uplink", "scopes": ["ingest"], "sensor_ids": ["mine"]},
            "read": {"name": "wall", "scopes": ["read"]},
        }
        for name, body in bodies.items():
            reply = running.post("/keys", json=body, headers=bearer(keys.get("admin")))
            assert reply.status_code == 201, reply.text
            keys[name] = reply.json()["secret"]
        running.keys = keys
        yield running


def bearer(key):
    return {} if key is None else {"Authorization": f"Bearer {key}"}


def test_the_first_key_closes_the_service(locked):
    reply = locked.get("/sensors")

    assert problem(reply, 401)["type"] == "/problems/unauthenticated"
    assert reply.headers["www-authenticate"].startswith("Bearer")
    assert locked.get("/session").json() == {"open": False, "key_id": None, "scopes": []}
    problem(locked.get("/sensors", headers=bearer("guessed")), 401)
    problem(locked.get("/sensors?key=" + locked.keys["read"]), 401)
    problem(locked.client.get("/healthz"), 401)
    problem(locked.client.get("/metrics"), 401)


def test_a_key_opens_what_its_scopes_say(locked):
    read, ingest, admin = (bearer(locked.keys[name]) for name in ("read", "ingest", "admin"))
    frame = recording("mine", 1)[0]

    assert locked.get("/sensors", headers=read).status_code == 200
    assert locked.get("/sensors", headers={"X-API-Key": locked.keys["read"]}).status_code == 200
    problem(locked.post("/sensors/mine/frames", json=frame, headers=read), 403)
    problem(locked.post("/sensors", json={"sensor_id": "x"}, headers=read), 403)
    problem(locked.get("/keys", headers=read), 403)
    problem(locked.get("/sensors", headers=ingest), 403)
    assert locked.post("/sensors/mine/frames", json=frame, headers=ingest).status_code == 202
    problem(locked.post("/sensors/other/frames", json=frame, headers=ingest), 403)
    problem(locked.post("/sensors/other/frames:batch", json=[], headers=ingest), 403)
    assert locked.get("/keys", headers=admin).json()["items"][0].keys() >= {"key_id", "scopes"}
    assert "secret" not in locked.get("/keys", headers=admin).text
    assert locked.post("/sensors/other/frames:batch", json=[], headers=admin).status_code == 202


def test_a_revoked_key_ends_at_once(locked):
    admin = bearer(locked.keys["admin"])
    made = locked.post("/keys", json={"name": "short", "scopes": ["read"]}, headers=admin).json()
    assert locked.get("/sites", headers=bearer(made["secret"])).status_code == 200

    assert locked.delete(f"/keys/{made['key_id']}", headers=admin).status_code == 204

    problem(locked.get("/sites", headers=bearer(made["secret"])), 401)
    problem(locked.delete("/keys/nothing", headers=admin), 404)
    problem(locked.post("/keys", json={"name": "n", "scopes": ["root"]}, headers=admin), 422)
    problem(
        locked.post("/keys", json={"name": "n", "scopes": ["ingest"], "sensor_ids": ["?"]}, headers=admin),
        422,
    )


def test_a_session_cookie_stands_for_its_key(locked):
    with httpx.Client(base_url=locked.url) as browser:
        made = browser.post("/api/v1/session", headers=bearer(locked.keys["read"]))
        cookie = made.headers["set-cookie"]

        assert {"HttpOnly", "SameSite=strict", "Path=/"} <= {part.strip() for part in cookie.split(";")}
        assert locked.keys["read"] not in cookie
        assert browser.get("/api/v1/sensors").status_code == 200
        assert browser.get("/api/v1/session").json()["scopes"] == ["read"]
        problem(browser.post("/api/v1/session"), 400)
        problem(browser.post("/api/v1/sites", json={}, headers={"Origin": "http://evil.example"}), 403)
        assert browser.delete("/api/v1/session").status_code == 204
        problem(browser.get("/api/v1/sensors"), 401)


def test_a_forged_session_is_no_session(locked):
    with httpx.Client(base_url=locked.url) as browser:
        browser.post("/api/v1/session", headers=bearer(locked.keys["read"]))
        payload, _, signature = browser.cookies["wayside_session"].partition(".")
    for forged in (f"{payload}.", f"{payload[:-2]}AA.{signature}", "x", ".", f"{signature}.{payload}", "é.é"):
        value = forged.encode()
        reply = locked.get("/sensors", headers={"Cookie": b"wayside_session=" + value})
        assert reply.status_code == 401


@pytest.mark.parametrize("host", ["evil.example", "evil.example:80", "127.0.0.1.evil.example", ""])
def test_a_strange_host_header_is_refused_on_the_loopback(service, host):
    problem(service.get("/sensors", headers={"Host": host}), 421)


def test_the_loopbacks_own_names_are_accepted(service):
    for host in ("localhost:8000", "LOCALHOST", "127.0.0.1:1", "[::1]:8000", "[::1]"):
        assert service.get("/sensors", headers={"Host": host}).status_code == 200


def test_a_page_of_another_origin_changes_nothing(service):
    body = {"sensor_id": "planted"}
    own = {"Origin": service.url}

    problem(service.post("/sensors", json=body, headers={"Origin": "http://evil.example"}), 403)
    problem(service.post("/sensors", json=body, headers={"Origin": "null"}), 403)
    assert service.post("/sensors", json=body, headers=own).status_code == 201


@pytest.fixture
def engine(tmp_path):
    engine = open_database(f"sqlite:///{tmp_path}/rows.sqlite")
    upgrade(engine)
    yield engine
    engine.dispose()


def test_a_session_expires(engine):
    now = [1_747_029_600_000_000]
    keyring = Keyring(engine, local=True, now_us=lambda: now[0])
    with session_scope(engine) as writer:
        key, _ = create_key(writer, name="k", scopes=["read"], now_us=now[0])
    session = keyring.open_session(key)

    assert keyring.identify(None, session).key.key_id == key.key_id
    now[0] += 12 * 3600 * 1_000_000
    with pytest.raises(Exception, match="an API key is needed"):
        keyring.identify(None, session)


def test_a_key_made_by_another_process_closes_the_service_within_seconds(engine):
    clock = [0.0]
    keyring = Keyring(engine, local=True, monotonic_s=lambda: clock[0])
    assert keyring.identify(None, None).key is None
    with session_scope(engine) as writer:
        create_key(writer, name="k", scopes=["read"], now_us=1)

    clock[0] += 5.0

    assert keyring.recall(None, None) is None
    assert not keyring.is_open()


EVERYWHERE = "0.0.0.0"  # noqa: S104 - nothing is bound


def test_a_service_that_others_can_reach_needs_a_key_to_start(engine):
    outside = Settings(_env_file=None, host=EVERYWHERE)

    with pytest.raises(InvalidInput, match="wayside key create"):
        refuse_open_network(engine, outside, insecure=False)
    refuse_open_network(engine, outside, insecure=True)
    refuse_open_network(engine, Settings(_env_file=None), insecure=False)
    with session_scope(engine) as writer:
        create_key(writer, name="k", scopes=["admin"], now_us=1)
    refuse_open_network(engine, outside, insecure=False)
    assert not Keyring(engine, local=False).is_open()


def test_names_of_hosts():
    assert [host_name(h) for h in ("A.b:80", "[::1]:8", "[::1]", "::1", "a")] == [
        "a.b",
        "[::1]",
        "[::1]",
        ":",
        "a",
    ]
    assert [is_loopback(h) for h in ("127.0.0.1", "::1", "[::1]", "localhost", EVERYWHERE, "a")] == [
        True,
        True,
        True,
        True,
        False,
        False,
    ]
