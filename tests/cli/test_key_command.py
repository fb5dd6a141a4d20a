"""`wayside key` and `wayside migrate` on a database of their own."""

from __future__ import annotations

import json

import pytest

import service
from service.storage.audit import list_acts
from service.storage.database import connection, open_database


@pytest.fixture
def run_on_data(run, tmp_path):
    return lambda *arguments, code=0: run(*arguments, "--data-dir", tmp_path / "data", code=code)


def test_a_key_is_created_listed_and_revoked(run_on_data):
    made = json.loads(
        run_on_data("key", "create", "--name", "dashboard", "--scope", "admin", "--json").stdout
    )
    listed = json.loads(run_on_data("key", "list", "--json").stdout)["keys"]
    run_on_data("key", "revoke", made["key_id"])

    assert len(made["key"]) > 40
    assert made["version"] == service.__version__
    assert [(key["key_id"], key["name"], key["scopes"]) for key in listed] == [
        (made["key_id"], "dashboard", ["admin"])
    ]
    assert "key" not in listed[0]
    assert json.loads(run_on_data("key", "list", "--json").stdout)["keys"] == []
    assert (
        json.loads(run_on_data("key", "list", "--revoked", "--json").stdout)["keys"][0]["revoked"] is not None
    )


def test_standard_output_is_the_secret_alone(run_on_data):
    result = run_on_data("key", "create", "--scope", "read")

    assert len(result.stdout.split()) == 1
    assert "cannot be shown again" in result.stderr


def test_people_read_a_table_of_keys(run_on_data):
    run_on_data("key", "create", "--name", "wall display", "--scope", "read")

    assert "wall display" in run_on_data("key", "list").stdout


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (("key", "create", "--scope", "owner"), "scopes"),
        (("key", "create", "--scope", "ingest", "--sensor", "radar-9"), "radar-9"),
        (("key", "revoke", "0000"), "no key 0000"),
    ],
)
def test_wrong_input_is_a_sentence_and_exit_code_2(run_on_data, arguments, reason):
    assert reason in run_on_data(*arguments, code=2).stderr


def test_migrate_brings_an_empty_database_up_to_date(run_on_data):
    run_on_data("migrate", "--check", code=1)
    first = json.loads(run_on_data("migrate", "--json").stdout)
    again = json.loads(run_on_data("migrate", "--json").stdout)

    assert first["before"] is None
    assert first["after"] == first["needed"] == again["before"] == again["after"]
    run_on_data("migrate", "--check")


def test_a_wrong_database_address_is_a_sentence(run_on_data):
    assert "sqlite or postgresql" in run_on_data("migrate", "--database", "mysql://host/name", code=1).stderr


def test_a_wrong_setting_of_the_environment_is_named(run_on_data, monkeypatch):
    monkeypatch.setenv("WAYSIDE_PORT", "many")

    assert "WAYSIDE_PORT" in run_on_data("migrate", code=2).stderr


def test_a_rotated_key_has_another_secret_and_each_act_is_written_down(run_on_data, tmp_path):
    made = json.loads(run_on_data("key", "create", "--json").stdout)
    rotated = json.loads(run_on_data("key", "rotate", made["key_id"], "--json").stdout)
    run_on_data("key", "revoke", made["key_id"])

    assert rotated["key_id"] == made["key_id"]
    assert len({made["key"], rotated["key"]}) == 2
    engine = open_database(f"sqlite:///{tmp_path}/data/rows.sqlite")
    with connection(engine) as reader:
        acts = list_acts(reader, target=made["key_id"]).items
    engine.dispose()
    assert [(act.actor, act.action) for act in acts] == [
        ("command line", f"key.{what}") for what in ("revoked", "rotated", "created")
    ]
    assert "is revoked" in run_on_data("key", "rotate", made["key_id"], code=1).stderr
