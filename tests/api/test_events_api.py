from __future__ import annotations

from service.api.schemas import Page
from service.api.track_schemas import EventReply
from service.formats.rfc3339 import format_time, parse_time_us
from tests.api.serving import problem, recording, until


def test_a_clock_that_is_set_back_opens_an_epoch_and_is_an_event(service):
    service.post("/sensors", json={"sensor_id": "reset"})
    sent = recording("reset", 30)
    service.post("/sensors/reset/frames:batch", json=sent)
    set_back = [
        frame
        | {
            "timestamp": format_time(parse_time_us(frame["timestamp"]) - 3_600_000_000),
            "frame": frame["frame"] + 30,
        }
        for frame in sent
    ]
    service.post("/sensors/reset/frames:batch", json=set_back)

    page = until(lambda: Page[EventReply].model_validate(service.get("/sensors/reset/events").json()).items)

    assert (page[0].kind, page[0].epoch, page[0].event_id) == ("tracker_restarted", 2, "reset-2-0")
    assert service.get("/sensors/reset/events?kind=other").json()["items"] == []
    until(lambda: service.get("/sensors/reset/live").json()["epoch"] == 2)
    problem(service.get("/sensors/nobody/events"), 404)
