from __future__ import annotations

import pytest
from starlette.requests import Request

from service.api.negotiation import choose_format
from service.api.problems import HttpProblem
from service.errors import InvalidInput

OFFERED = ("json", "ndjson", "csv", "geojson")


def choose(accept=None, wanted=None):
    headers = [] if accept is None else [(b"accept", accept.encode())]
    return choose_format(Request({"type": "http", "headers": headers}), wanted, OFFERED)


@pytest.mark.parametrize(
    ("accept", "form"),
    [
        (None, "json"),
        ("*/*", "json"),
        ("text/csv", "csv"),
        ("text/*", "csv"),
        ("application/geo+json, application/json;q=0.5", "geojson"),
        ("application/json;q=0.2, application/x-ndjson;q=0.9", "ndjson"),
        ("application/json;q=0, */*", "ndjson"),
        ("text/html, */*;q=0.1", "json"),
    ],
)
def test_the_best_acceptable_form_is_chosen(accept, form):
    assert choose(accept) == form


def test_the_query_overrules_the_header():
    assert choose("text/csv", "geojson") == "geojson"


def test_what_cannot_be_given_is_refused():
    with pytest.raises(HttpProblem, match="text/csv"):
        choose("image/png")
    with pytest.raises(HttpProblem):
        choose("application/json;q=high")
    with pytest.raises(InvalidInput, match="/format"):
        choose(wanted="xml")
