from __future__ import annotations

import asyncio
from collections import deque

import pytest

from service.errors import Unavailable
from service.pipeline.channel import Doorway
from service.pipeline.door import Door, Outcome
from service.pipeline.order import OrderState
from service.telemetry import Telemetry
from tests.pipeline.recordings import CONFIG, recording


class FakeLog:
    """A log whose answers the test gives, in any order."""

    def __init__(self) -> None:
        self.asked = []

    def append_async(self, _sensor_id, records):
        answer = asyncio.get_running_loop().create_future()
        self.asked.append((records, answer))
        return answer


def doorway() -> Doorway:
    return Doorway("radar-1", CONFIG, OrderState(), OrderState(), deque())


def test_frames_that_the_log_refused_are_no_repeats_though_later_ones_were_logged():
    async def run():
        log = FakeLog()
        door, channel = Door(log, Telemetry(), 60.0), doorway()
        first, second = recording(2)

        async def post(one):
            return (await door.submit(channel, [one], one.time_us))[0].outcome

        posts = [asyncio.ensure_future(post(f)) for f in (first, second)]
        await asyncio.sleep(0)
        log.asked[0][1].set_exception(Unavailable("the log cannot be written"))
        log.asked[1][1].set_result([1])
        with pytest.raises(Unavailable):
            await posts[0]
        assert await posts[1] is Outcome.ACCEPTED

        again = [asyncio.ensure_future(post(f)) for f in (first, second)]
        await asyncio.sleep(0)
        for _, answer in log.asked[2:]:
            answer.set_result([2])
        return [await one for one in again]

    outcomes = asyncio.run(run())

    assert outcomes[0] is not Outcome.DUPLICATE
    assert outcomes[1] is Outcome.DUPLICATE
