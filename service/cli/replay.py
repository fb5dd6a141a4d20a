"""`wayside replay`: post recorded frames to a running service, as if they were measured now."""

from __future__ import annotations

import gzip
import math
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import orjson
import typer

from service.cli import options
from service.cli.edge import FAILED, one_sentence, say
from service.cli.output import print_facts, print_json, progress, provenance
from service.errors import Conflict, InvalidInput, Unavailable

if TYPE_CHECKING:
    from service.cli.client import Client
    from service.cli.recording import RecordedFrame, Recording

BATCH_FRAMES = 200  # some 2 MB of rows before compression, far below the body limit
PATIENCE_S = 60.0  # how long a full log or a restart is waited for
COMPRESSION = 1  # the fastest; frames shrink to a quarter even so
FATES = ("accepted", "duplicate", "late", "conflict", "rejected")


@one_sentence()
def replay(
    frames: Annotated[list[Path], typer.Argument(metavar="FRAMES...", help="JSON lines, gzip or not.")],
    *,
    url: options.Url = options.DEFAULT_URL,
    key: options.Key = None,
    speed: Annotated[
        str, typer.Option(metavar="FACTOR", help="1: the pace of life; N: N times as fast; max.")
    ] = "1",
    keep_times: Annotated[
        bool,
        typer.Option(
            "--keep-times", help="Keep times and boots; else they are shifted to now, in a new boot."
        ),
    ] = False,
    sensor: Annotated[
        str | None, typer.Option(help="Post as this sensor. [default: as the frames say]")
    ] = None,
    register: Annotated[
        Path | None, typer.Option(metavar="SITE.json", help="Register this sensor first, unless it exists.")
    ] = None,
    show: options.ShowProgress = None,
    as_json: options.Json = False,
) -> None:
    """Post a recording to a running service."""
    from service.cli.client import Client
    from service.cli.recording import look_through

    factor = _factor(speed)
    recording = look_through(frames)
    sensor_id = sensor or recording.sensor_id
    if sensor_id is None:
        raise InvalidInput("the frames do not name their sensor; name it by --sensor")
    begun_s = time.monotonic()
    with Client(url, key) as client, progress(wanted=show) as bar:
        if register is not None:
            sensor_id = _register(client, register, sensor)
        task = bar.add_task(f"{sensor_id} -> {url}", total=recording.frames)
        post = _Poster(client, sensor_id, lambda count: bar.advance(task, count))
        moved = _as_it_is if keep_times else _to_now(recording, factor)
        _play(recording, factor, lambda frame: moved(frame) | {"sensor_id": sensor_id}, post)
    result = provenance() | {"sensor_id": sensor_id, "frames": recording.frames}
    result |= {fate: post.fates[fate] for fate in FATES} | {"seconds": round(time.monotonic() - begun_s, 3)}
    if as_json:
        print_json(result)
    else:
        print_facts(f"Replay of {sensor_id}", result)
    if post.trouble is not None:
        say(post.trouble)
        raise typer.Exit(FAILED)


class _Poster:
    """Collects frames and posts them in batches; remembers what became of them."""

    def __init__(self, client: Client, sensor_id: str, advance: Callable[[int], None]) -> None:
        self.fates: Counter[str] = Counter()
        self.trouble: str | None = None  # the first frame that was not taken, and why
        self._client = client
        self._path = f"/sensors/{sensor_id}/frames:batch"
        self._advance = advance
        self._lines: list[bytes] = []
        self._patience_s = 0.0  # none before the first batch: then the address or the key is wrong

    @property
    def waiting(self) -> int:
        """Frames that are collected and not posted."""
        return len(self._lines)

    def add(self, frame: dict[str, object]) -> None:
        """Collect a frame."""
        self._lines.append(orjson.dumps(frame))

    def flush(self) -> None:
        """Post what is collected; when the service is busy, wait as it asks."""
        body = gzip.compress(b"\n".join(self._lines), COMPRESSION)
        give_up_s = time.monotonic() + self._patience_s
        while True:
            try:
                reply = self._client.post_ndjson(self._path, body)
                break
            except Unavailable as error:
                if time.monotonic() + error.retry_after_s > give_up_s:
                    raise
                time.sleep(error.retry_after_s)
        self._patience_s = PATIENCE_S
        self._note(reply)
        self._advance(len(self._lines))
        self._lines.clear()

    def _note(self, reply: dict[str, object]) -> None:
        results = reply.get("results")
        for item in results if isinstance(results, list) else []:
            fate = str(item.get("status"))
            self.fates[fate] += 1
            if fate in {"conflict", "rejected"} and self.trouble is None:
                self.trouble = f"frame {item.get('frame')} was not taken: {item.get('detail') or fate}"


def _play(
    recording: Recording, factor: float, moved: Callable[[RecordedFrame], dict[str, object]], post: _Poster
) -> None:
    """Post every frame when it is due."""
    from service.cli.recording import read_recording

    start_s = time.monotonic()
    for frame in read_recording(recording.paths):
        due_s = start_s + recording.due_s(frame.time_us, factor)
        if post.waiting and (due_s > time.monotonic() or post.waiting >= BATCH_FRAMES):
            post.flush()
        time.sleep(max(due_s - time.monotonic(), 0.0))
        post.add(moved(frame))
    post.flush()


def _as_it_is(frame: RecordedFrame) -> dict[str, object]:
    return frame.content


def _to_now(recording: Recording, factor: float) -> Callable[[RecordedFrame], dict[str, object]]:
    from service.cli.database import now_us

    begun_us = now_us()
    shift_us = recording.shift_us(begun_us, factor)
    boot_id = f"replay-{begun_us}"
    return lambda frame: frame.moved(shift_us, boot_id)


def _register(client: Client, site: Path, sensor: str | None) -> str:
    from service.cli.site_file import read_site

    config = read_site(site)
    if sensor is not None:
        config = config.model_copy(update={"sensor_id": sensor})
    try:
        client.request("POST", "/sensors", json=config.model_dump(mode="json"))
    except Conflict as error:
        say(str(error))
    return config.sensor_id


def _factor(speed: str) -> float:
    if speed == "max":
        return math.inf
    try:
        factor = float(speed)
    except ValueError:
        factor = math.nan
    if not 0 < factor < math.inf:
        raise InvalidInput(f"--speed wants a number above 0 or max, got {speed!r}")
    return factor
