from __future__ import annotations

import re

import pytest
from pydantic import TypeAdapter

from service.api import diagnosis, examples, flow_schemas, lane_schemas, schemas, track_schemas
from service.api.openapi import operations
from service.api.problems import Problem
from service.api.schemas import Page
from service.formats.json_frames import parse_frame
from service.formats.sensor import LaneControl, SensorConfig

MODELS = {
    "create_site": schemas.SiteReply,
    "list_sites": Page[schemas.SiteReply],
    "read_site": schemas.SiteReply,
    "change_site": schemas.SiteReply,
    "create_sensor": schemas.SensorReply,
    "list_sensors": Page[schemas.SensorReply],
    "read_sensor": schemas.SensorReply,
    "change_sensor": schemas.SensorReply,
    "post_frame": track_schemas.FrameReply,
    "post_frames": track_schemas.BatchReply,
    "read_live": track_schemas.LiveView,
    "read_lanes": lane_schemas.LaneMapReply,
    "read_lane_versions": Page[lane_schemas.LaneVersionReply],
    "control_lanes": LaneControl,
    "read_lane_changes": Page[lane_schemas.LaneChangeReply],
    "read_tracks": Page[track_schemas.TrackReply],
    "read_track": track_schemas.TrackReply,
    "read_track_states": Page[track_schemas.StateReply],
    "read_events": Page[track_schemas.EventReply],
    "read_crossings": Page[flow_schemas.CrossingReply],
    "read_flow": flow_schemas.FlowReply,
    "read_cells": flow_schemas.CellReply,
    "read_evidence": flow_schemas.EvidenceReply,
    "read_coverage": flow_schemas.CoverageReply,
    "read_movements": flow_schemas.MovementReply,
    "check_manual_counts": flow_schemas.CheckReply,
    "read_checks": flow_schemas.CheckReply,
    "read_diagnosis": diagnosis.DiagnosisReply,
    "create_key": schemas.NewKeyReply,
    "rotate_key": schemas.NewKeyReply,
    "list_keys": Page[schemas.KeyReply],
    "read_audit": Page[schemas.ActReply],
    "purge_sensor": schemas.PurgeReply,
    "restart_sensor": schemas.RestartReply,
    "read_session": schemas.SessionReply,
    "open_session": schemas.SessionReply,
    "live": schemas.AliveReply,
    "ready": schemas.ReadyReply,
    "health": schemas.HealthReply,
}


@pytest.fixture(scope="module")
def schema(service):
    return service.client.get("/openapi.json").json()


def test_the_description_is_openapi_3_1_with_tags_and_security(schema):
    assert schema["openapi"].startswith("3.1")
    assert set(schema["components"]["securitySchemes"]) == {"bearer", "header", "session"}
    known = {tag["name"] for tag in schema["tags"]}
    for path, _, operation in operations(schema):
        assert set(operation["tags"]) <= known
        assert operation["description"]
        secured = path.startswith("/api/") and not path.endswith("/session")
        assert not secured or operation["security"]


def test_every_operation_has_an_example(schema):
    for path, method, operation in operations(schema):
        name = operation["operationId"]
        replies = [
            content
            for status, reply in operation["responses"].items()
            if status.startswith("2")
            for content in reply.get("content", {}).values()
            if content.get("examples")
        ]
        assert replies or name in examples.BODILESS, (method, path)
        if method in {"post", "patch"} and "requestBody" in operation:
            content = next(iter(operation["requestBody"]["content"].values()))
            assert content["examples"], (method, path)


def test_every_operation_describes_its_problems(schema):
    for path, method, operation in operations(schema):
        assert "application/problem+json" in operation["responses"]["default"]["content"], (method, path)
    assert "HTTPValidationError" not in schema["components"]["schemas"]


def test_every_reference_leads_somewhere(schema):
    names = set(re.findall(r"#/components/schemas/([\w.-]+)", str(schema)))

    assert names <= set(schema["components"]["schemas"])
    assert {"FrameInput", "Problem", "LiveView"} <= names


@pytest.mark.parametrize("name", sorted(MODELS))
def test_every_example_of_a_reply_fits_its_model(name):
    value = examples.RESPONSES[name]
    adapter = TypeAdapter(MODELS[name])

    shown = adapter.dump_python(adapter.validate_python(value), mode="json", exclude_unset=True)

    assert shown == value


def test_examples_of_requests_are_accepted():
    assert set(examples.RESPONSES) == set(MODELS)
    schemas.SiteInput.model_validate(examples.SITE)
    schemas.SensorInput.model_validate(examples.SENSOR)
    schemas.KeyInput.model_validate(examples.KEY)
    Problem.model_validate(examples.PROBLEM)
    for frame in (examples.FRAME, examples.FRAME_ROWS):
        assert len(parse_frame(frame, SensorConfig(sensor_id="radar-1"))) > 0
        track_schemas.FrameInput.model_validate(frame)


def test_the_reference_page_shows_every_operation_and_loads_nothing(service, schema):
    page = service.client.get("/docs")

    assert page.status_code == 200
    for path, _, _ in operations(schema):
        assert path in page.text
    assert "<script" not in page.text
    assert "default-src 'none'" in page.headers["content-security-policy"]
