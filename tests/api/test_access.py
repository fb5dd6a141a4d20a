from __future__ import annotations

import json
import threading

import httpx
import pytest
import structlog
from sqlalchemy import func, select, text

from service.api import sensors as sensor_routes
from service.settings import Settings
from service.storage.database import connection
from service.storage.purge import tables_of_sensors
from service.storage.tables import metadata
from tests.api.serving import problem, recording, serving, until
from tests.api.test_security import bearer


@pytest.fixture(scope="module")
def keyed(tmp_path_factory):
    """A service with an admin key, that takes three reads a minute and two guesses."""
    limits = {"rate_limit_read": "3/minute", "rate_limit_guesses": "2/minute", "rate_limit_admin": None}
    with serving(tmp_path_factory.mktemp("keyed"), **limits) as running:
        made = running.post("/keys", json={"name": "admin", "scopes": ["admin"]}).json()
        running.admin, running.admin_id = bearer(made["secret"]), made["key_id"]
        yield running


def make_key(keyed, *scopes):
    made = keyed.post("/keys", json={"name": "k", "scopes": list(scopes)}, headers=keyed.admin).json()
    return made["key_id"], made["secret"]


def acts(service, **query):
    items = service.get("/audit", params=query, headers=getattr(service, "admin", {})).json()["items"]
    return [(act["actor"], act["action"], act["target"]) for act in items]


def test_a_rotated_key_has_another_secret_and_the_old_one_and_its_sessions_end_at_once(keyed):
    key_id, old = make_key(keyed, "admin")
    with httpx.Client(base_url=keyed.url) as browser:
        browser.post("/api/v1/session", headers=bearer(old))
        assert browser.get("/api/v1/keys").status_code == 200

        made = keyed.post(f"/keys/{key_id}:rotate", headers=bearer(old))

        assert made.headers["cache-control"] == "no-store"
        assert made.json()["key_id"] == key_id
        problem(browser.get("/api/v1/keys"), 401)
        problem(keyed.get("/keys", headers=bearer(old)), 401)
        assert keyed.get("/keys", headers=bearer(made.json()["secret"])).status_code == 200
    assert acts(keyed, target=key_id) == [
        (key_id, "key.rotated", key_id),
        (keyed.admin_id, "key.created", key_id),
    ]
    keyed.delete(f"/keys/{key_id}", headers=keyed.admin)
    problem(keyed.post(f"/keys/{key_id}:rotate", headers=keyed.admin), 409)
    problem(keyed.post("/keys/nothing:rotate", headers=keyed.admin), 404)


def test_a_key_may_ask_so_often_and_is_told_what_is_left(keyed):
    (_, one), (_, other) = make_key(keyed, "read"), make_key(keyed, "read")

    replies = [keyed.get("/sites", headers=bearer(one)) for _ in range(4)]

    assert [reply.status_code for reply in replies] == [200, 200, 200, 429]
    assert replies[0].headers["ratelimit-policy"] == '"read";q=3;w=60'
    assert replies[0].headers["ratelimit"].startswith('"read";r=2;t=')
    assert problem(replies[3], 429)["type"] == "/problems/too-many-requests"
    assert 1 <= int(replies[3].headers["retry-after"]) <= 60
    assert keyed.get("/sites", headers=bearer(other)).status_code == 200
    assert "ratelimit" not in keyed.get("/keys", headers=keyed.admin).headers


def test_an_address_that_guesses_keys_is_put_off_but_its_valid_keys_are_not(keyed):
    replies = [keyed.get("/sites", headers=bearer(f"guess {n}")) for n in range(4)]

    assert [reply.status_code for reply in replies[-2:]] == [429, 429]
    keyed.app.state.services.keyring.forget()
    assert keyed.get("/keys", headers=keyed.admin).status_code == 200


def test_a_rate_that_is_none_is_refused_at_the_start():
    assert Settings(_env_file=None, rate_limit_read="none").rate_limit_read is None
    with pytest.raises(ValueError, match="200/second"):
        Settings(_env_file=None, rate_limit_read="often")


def test_every_change_is_in_the_audit_log_and_only_an_admin_reads_it(keyed):
    site = {"site_id": "north", "name": "n", "latitude_deg": 1, "longitude_deg": 2}
    keyed.post("/sites", json=site, headers=keyed.admin)
    keyed.patch("/sites/north", json={"name": "m"}, headers=keyed.admin)
    keyed.post("/sites", json=site, headers=keyed.admin)  # a conflict changes nothing
    keyed.delete("/sites/north", headers=keyed.admin)
    keyed.post("/sensors", json={"sensor_id": "a1"}, headers=keyed.admin)
    keyed.patch("/sensors/a1", json={"heading_deg": 4}, headers=keyed.admin)
    keyed.delete("/sensors/a1", headers=keyed.admin)

    assert [action for _, action, _ in acts(keyed, target="north")] == [
        "site.archived",
        "site.changed",
        "site.created",
    ]
    assert [action for _, action, _ in acts(keyed, target="a1")] == [
        "sensor.archived",
        "sensor.changed",
        "sensor.created",
    ]
    newest = keyed.get("/audit?limit=2", headers=keyed.admin)
    assert newest.json()["items"][1]["detail"] == {"heading_deg": 4}
    following = newest.links["next"]["url"].removeprefix("/api/v1")
    assert len(keyed.get(following, headers=keyed.admin).json()["items"]) == 2
    _, reader = make_key(keyed, "read")
    problem(keyed.get("/audit", headers=bearer(reader)), 403)


def test_a_purged_sensor_leaves_nothing_behind_and_its_id_stays_taken(service):
    for sensor_id in ("gone", "stays"):
        service.post("/sensors", json={"sensor_id": sensor_id})
        service.post(f"/sensors/{sensor_id}/frames:batch", json=recording(sensor_id))
    problem(service.post("/sensors/gone:purge"), 409)
    until(lambda: service.get("/tracks?sensor_id=gone").json()["items"])
    service.delete("/sensors/gone")
    assert service.get("/tracks?sensor_id=gone").json()["items"]  # archived: readable

    done = until(lambda: (r := service.post("/sensors/gone:purge")).status_code == 200 and r).json()

    assert done["rows"]["tracks"] == 2
    assert service.get("/tracks?sensor_id=gone").json()["items"] == []
    assert service.host._frame_log.read("gone", 0, 10) == []
    assert service.host._frame_log.read("stays", 0, 10)
    assert b"gone" not in log_bytes(service)
    with connection(service.engine) as reader:
        ordinal = reader.scalar(text("SELECT ordinal FROM sensors WHERE sensor_id = 'gone'"))
        for table in tables_of_sensors():
            query = select(func.count()).select_from(table).where(table.c.sensor == ordinal)
            assert reader.scalar(query) == 0, table.name
    problem(service.post("/sensors", json={"sensor_id": "gone"}), 409)
    problem(service.post("/sensors/nobody:purge"), 404)
    assert acts(service, action="sensor.purged") == [("nobody", "sensor.purged", "gone")]


def test_a_sensor_that_has_not_failed_is_not_restarted_and_only_an_admin_asks(service, keyed):
    service.post("/sensors", json={"sensor_id": "well"})

    assert "has not failed" in problem(service.post("/sensors/well:restart?skip=true"), 409)["detail"]
    problem(service.post("/sensors/nobody:restart"), 404)
    problem(service.post("/sensors/well:restart?skip=perhaps"), 422)
    assert acts(service, action="sensor.restarted") == []
    _, reader = make_key(keyed, "read")
    problem(keyed.post("/sensors/any:restart", headers=bearer(reader)), 403)


def log_bytes(service):
    """What stands in the files of the log, past the header that names the sensors whose positions went on."""
    folder = service.host._settings.log_dir
    return b"".join(path.read_bytes() for path in folder.glob("segment-*.sqlite"))


def test_purging_knows_every_table_that_speaks_of_sensors():
    named = {table.name for table in metadata.sorted_tables if {"sensor", "sensor_id"} & set(table.c.keys())}

    assert named - {"sensors"} == {table.name for table in tables_of_sensors()}


def test_a_repeated_post_gets_the_first_reply_and_has_no_second_effect(service):
    body = {"site_id": "twice", "name": "n", "latitude_deg": 1, "longitude_deg": 2}
    headers = {"Idempotency-Key": '"8e03978e-40d5"'}

    first = service.post("/sites", json=body, headers=headers)
    again = service.post("/sites", json=body, headers=headers)
    bare = service.post("/sites", json=body, headers={"Idempotency-Key": "8e03978e-40d5"})
    other = service.post("/sites", json=body | {"name": "other"}, headers=headers)

    assert (first.status_code, again.status_code, bare.status_code) == (201, 201, 201)
    assert again.json() == first.json()
    assert again.headers["location"] == first.headers["location"]
    assert (again.headers["idempotency-replayed"], first.headers.get("idempotency-replayed")) == (
        "true",
        None,
    )
    assert "another body" in problem(other, 422)["detail"]
    problem(service.post("/sites", json=body, headers={"Idempotency-Key": "new"}), 409)
    problem(service.post("/sites", json=body, headers={"Idempotency-Key": 'a"b'}), 400)
    assert acts(service, target="twice") == [("nobody", "site.created", "twice")]


def test_a_refused_post_may_be_tried_again_under_its_key(service):
    body = {"site_id": "fixed", "name": "n", "latitude_deg": 91, "longitude_deg": 2}
    headers = {"Idempotency-Key": "fix"}

    problem(service.post("/sites", json=body, headers=headers), 422)

    assert service.post("/sites", json=body | {"latitude_deg": 9}, headers=headers).status_code == 201


def test_the_secret_of_a_key_is_not_kept_for_repeats(keyed):
    body, headers = {"name": "once", "scopes": ["read"]}, {"Idempotency-Key": "k1", **keyed.admin}

    made = keyed.post("/keys", json=body, headers=headers)
    again = problem(keyed.post("/keys", json=body, headers=headers), 409)

    assert made.json()["key_id"] in again["detail"]
    with connection(keyed.engine) as reader:
        kept = str(reader.execute(text("SELECT * FROM kept_replies")).all())
    assert made.json()["secret"] not in kept
    assert keyed.post("/keys", json=body, headers={"Idempotency-Key": "k1"}).status_code == 401


def test_a_request_whose_first_try_still_runs_is_a_conflict(service, monkeypatch):
    begun, go_on = threading.Event(), threading.Event()
    create = sensor_routes.store.create_site

    def slowly(*args, **more):
        begun.set()
        go_on.wait(10)
        return create(*args, **more)

    monkeypatch.setattr(sensor_routes.store, "create_site", slowly)
    body = {"site_id": "slow", "name": "n", "latitude_deg": 1, "longitude_deg": 2}
    with httpx.Client(base_url=service.url) as beside:
        post = {"json": body, "headers": {"Idempotency-Key": "slow"}}
        first = []
        thread = threading.Thread(target=lambda: first.append(beside.post("/api/v1/sites", **post)))
        thread.start()
        begun.wait(10)
        assert "still running" in problem(service.post("/sites", **post), 409)["detail"]
        go_on.set()
        thread.join()

    assert first[0].status_code == 201


@pytest.mark.parametrize(
    ("content", "headers", "status"),
    [
        (b"site_id=x", {"Content-Type": "application/x-www-form-urlencoded"}, 415),
        (b"{}", {"Content-Encoding": "gzip"}, 415),
        (b'{"site_id": "x", "site_id": "y"}', {}, 422),
        (b'{"latitude_deg": NaN}', {}, 422),
        (b"[" * 5000, {}, 422),
        (b" " * 2**20 + b"{}", {}, 413),
    ],
)
def test_a_change_wants_clear_json_of_bounded_size(service, content, headers, status):
    problem(service.post("/sites", content=content, headers=headers), status)
    problem(service.patch("/sensors/radar-1", content=content, headers=headers), status)


def test_pages_and_replies_say_what_a_browser_may_load(service):
    page = service.client.get("/").headers["content-security-policy"]
    reply = service.client.get("/livez").headers["content-security-policy"]
    docs = service.client.get("/docs").headers["content-security-policy"]

    assert "default-src 'none'; script-src 'self'" in page
    assert "frame-ancestors 'none'" in page
    assert reply.startswith("default-src 'none'")
    assert "style-src 'sha256-" in docs
    assert not any("unsafe" in policy for policy in (page, reply, docs))


def test_no_key_and_no_trace_reaches_the_log_or_a_reply(keyed, monkeypatch, capsys):
    _, secret = make_key(keyed, "admin")

    def fail(*_args, **_more):
        raise RuntimeError("a fault of the service")

    monkeypatch.setattr(sensor_routes.store, "list_sensors", fail)
    with structlog.testing.capture_logs() as lines:
        reply = keyed.get("/sensors", headers=bearer(secret))
        keyed.get("/sensors", headers=bearer("no key at all"))

    body = problem(reply, 500)
    assert "a fault of" not in json.dumps(body)
    assert any(line["event"] == "request failed" for line in lines)
    for text_of in (str(lines), reply.text, *capsys.readouterr()):
        assert secret not in text_of
        assert "no key at all" not in text_of
        assert "Traceback" not in text_of
