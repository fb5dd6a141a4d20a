"""Ask every operation of the OpenAPI document with what it describes, and with what it does not."""

from __future__ import annotations

import pytest
import schemathesis
from hypothesis import HealthCheck, given, settings
from hypothesis.errors import Unsatisfiable
from schemathesis import GenerationMode
from schemathesis.checks import not_a_server_error
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    negative_data_rejection,
    response_headers_conformance,
    response_schema_conformance,
    status_code_conformance,
)

from tests.api.serving import serving

CHECKS = [
    not_a_server_error,
    content_type_conformance,
    negative_data_rejection,
    response_headers_conformance,
    response_schema_conformance,
    status_code_conformance,
]
ENDLESS = {"stream_live"}


@pytest.fixture(scope="module")
def described(tmp_path_factory):
    with serving(tmp_path_factory.mktemp("fuzzed"), body_limit_bytes=1_000_000) as running:
        running.post("/sensors", json={"sensor_id": "radar-1"})
        yield schemathesis.openapi.from_url(f"{running.url}/openapi.json")


def operations(described):
    found = [result.ok() for result in described.get_all_operations()]
    return [one for one in found if one.definition.raw["operationId"] not in ENDLESS]


@pytest.mark.slow
@pytest.mark.parametrize("mode", [GenerationMode.POSITIVE, GenerationMode.NEGATIVE])
def test_every_operation_keeps_to_its_description(described, mode):
    failures = []
    for operation in operations(described):

        @given(case=operation.as_strategy(generation_mode=mode))
        @settings(
            max_examples=6,
            derandomize=True,
            database=None,
            deadline=None,
            suppress_health_check=list(HealthCheck),
        )
        def keeps_to_it(case) -> None:
            if "wait" in (case.query or {}):
                case.query = {**case.query, "wait": 0}  # a long poll that waits finds out nothing more
            case.call_and_validate(checks=CHECKS)

        try:
            keeps_to_it()
        except Unsatisfiable:  # it takes nothing that could be wrong
            assert mode is GenerationMode.NEGATIVE, operation.label
        except Exception as error:  # noqa: BLE001 - whatever schemathesis found, of every operation
            failures.append(f"{operation.label}: {error!r} {getattr(error, 'exceptions', '')}"[:1500])
    assert not failures, "\n\n".join(failures)
