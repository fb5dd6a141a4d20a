from __future__ import annotations

import pytest

from tests.api.serving import serving

PLACE = {"latitude_deg": 48.137, "longitude_deg": 11.575, "heading_deg": 12.5}


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    """A service without keys, with one registered sensor at a known place."""
    with serving(tmp_path_factory.mktemp("data")) as running:
        reply = running.post("/sensors", json={"sensor_id": "radar-1", **PLACE})
        assert reply.status_code == 201, reply.text
        yield running
