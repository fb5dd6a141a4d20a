"""Put the frames of one sensor into order: hold early ones, count gaps, tell repeats, late ones and reboots.

Rules, in this order, for a frame against what has been seen of its sensor:

1. A `boot_id` not seen before opens a new boot; one of a former boot is late. Without `boot_id`, a number
   that goes back while time goes on opens a new boot.
2. Same key (boot and number, or boot and time for a frame without number) as a recent frame: duplicate when
   the content is equal, else conflict. A frame without `boot_id` does not say of which boot it is: with the
   number and content of a recent frame of any boot it is a duplicate.
3. A number not above the newest folded one is late.
4. Time must go on: a frame not after the newest folded frame or tick is late, whatever its number. When
   several frames in a row have rising numbers but stand far back, the sensor's clock was set: the tracker
   restarts.
5. The next number is released at once; another is held until the missing one arrives or two further
   frames have come, and then the gap is counted.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np

from service.formats.columnar import content_digest
from service.tracking.model import I64, Frame

REORDER_WINDOW = 2  # further frames that a held frame waits for
RECENT_KEYS = 256  # frames whose key and content are remembered: 12 s at 20 Hz
FORMER_BOOTS = 8
CLOCK_STEP_US = 10_000_000  # standing further back than this is no jitter, but a clock that was set
CLOCK_STEP_FRAMES = 3  # in a row, so that one frame with a wrong time restarts nothing
NUMBER_JUMP = 60_000  # inside one second: below what a block's 16-bit frame offset holds
_SECOND_US = 1_000_000


class Fate(StrEnum):
    """What became of a record."""

    TRACKED = "tracked"
    HELD = "held"
    LATE = "late"
    DUPLICATE = "duplicate"
    CONFLICT = "conflict"
    CONTROL = "control"
    TICK = "tick"
    DAMAGED = "damaged"


@dataclass(frozen=True, slots=True)
class RecentKeys:
    """The keys of the newest frames, oldest first: (K,) each."""

    space: I64  # twice the boot, plus one for a frame without number
    key: I64  # number, or time
    digest: I64  # content

    def digest_of(self, space: int, key: int) -> int | None:
        """Return the content that was seen under a key, None when the key is not among the recent ones."""
        equal = self.key == key
        if not equal.any():
            return None
        found = np.flatnonzero(equal & (self.space == space))
        return int(self.digest[found[-1]]) if len(found) else None

    def repeats(self, key: int, digest: int) -> bool:
        """Return whether a number was seen with this content (which holds the time), in whatever boot."""
        equal = self.key == key
        if not equal.any():
            return False
        return bool((equal & (self.digest == digest) & (self.space % 2 == 0)).any())

    def remember(self, space: int, key: int, digest: int) -> RecentKeys:
        """Return the keys with one more, and the oldest forgotten when there are too many."""
        return RecentKeys(_with(self.space, space), _with(self.key, key), _with(self.digest, digest))


def _with(column: I64, value: int) -> I64:
    """Return the column's newest values and one more; np.append takes five times as long."""
    kept = column[1 - RECENT_KEYS :]
    longer = np.empty(len(kept) + 1, dtype=np.int64)
    longer[:-1] = kept
    longer[-1] = value
    return longer


def _no_keys() -> RecentKeys:
    empty = np.zeros(0, dtype=np.int64)
    return RecentKeys(empty, empty, empty)


@dataclass(frozen=True, slots=True)
class OrderState:
    """What ordering needs to know of the past."""

    boot: int = 0  # counts the boots of the epoch
    boot_id: str | None = None
    former_boots: tuple[tuple[int, str], ...] = ()
    sequence: int | None = None  # newest released number of this boot
    time_us: int | None = None  # of the newest released frame or tick
    number: int = -1  # newest frame number given out; a radar may count from 0
    number_offset: int = 0  # frame number less the number on the wire
    far_back: int = 0  # frames in a row with a rising number and a time far back
    held: tuple[Frame, ...] = ()  # by number
    recent: RecentKeys = field(default_factory=_no_keys)

    @property
    def newest_us(self) -> int | None:
        """Time of the newest frame or tick, held ones included."""
        times = [frame.time_us for frame in self.held]
        return max(times if self.time_us is None else [*times, self.time_us], default=None)


@dataclass(frozen=True, slots=True)
class Released:
    """A frame whose turn has come."""

    frame: Frame
    number: int  # the number on the wire; counts on where that went back, so it rises through the whole epoch
    boot: int


@dataclass(frozen=True, slots=True)
class Admission:
    """What one frame, or a flush, did to the order."""

    fate: Fate
    released: tuple[Released, ...] = ()
    missing: int = 0  # numbers given up as lost
    dropped: int = 0  # held frames that turned out not to be later than the one before
    clock_step: bool = False  # the sensor's clock was set back; `released` begins a new history


def admit(state: OrderState, frame: Frame, digest: int | None = None) -> tuple[OrderState, Admission]:
    """Return the state after one more frame has arrived, and what became of it.

    digest: the frame's content_digest, where it is known already.
    """
    boot, opens = _boot_of(state, frame)
    numbered = frame.sequence is not None
    key = frame.time_us if frame.sequence is None else frame.sequence
    digest = content_digest(frame) if digest is None else digest
    space = 2 * boot + (not numbered)
    seen = None if opens else state.recent.digest_of(space, key)
    if seen != digest and numbered and frame.boot_id is None and state.recent.repeats(key, digest):
        return state, Admission(Fate.DUPLICATE)
    if seen is not None:
        return state, Admission(Fate.DUPLICATE if seen == digest else Fate.CONFLICT)
    state = _with_recent(state, state.recent.remember(space, key, digest))
    if boot < state.boot:
        return state, Admission(Fate.LATE)
    before = Admission(Fate.TRACKED)
    if opens or not numbered:
        state, before = flush(state)
    if opens:
        state = _open_boot(state, boot, frame.boot_id)
    state, after = _place(state, frame)
    if not (before.released or before.missing or before.dropped):
        return state, after
    return state, replace(
        after,
        released=before.released + after.released,
        missing=before.missing + after.missing,
        dropped=before.dropped + after.dropped,
    )


def _with_recent(state: OrderState, recent: RecentKeys) -> OrderState:
    """Return the state with other recent keys; `replace` takes five times as long, once a frame."""
    return OrderState(
        state.boot,
        state.boot_id,
        state.former_boots,
        state.sequence,
        state.time_us,
        state.number,
        state.number_offset,
        state.far_back,
        state.held,
        recent,
    )


def flush(state: OrderState) -> tuple[OrderState, Admission]:
    """Release every held frame, as when no more are to be expected."""
    return _drain(state, window=0)


def pass_time(state: OrderState, time_us: int) -> OrderState:
    """Return the state after a tick: frames up to its time are late from now on."""
    return replace(state, time_us=time_us)


def _boot_of(state: OrderState, frame: Frame) -> tuple[int, bool]:
    """Return the boot that the frame belongs to, and whether it opens it."""
    if state.time_us is None:
        return state.boot, True
    if frame.boot_id is not None and frame.boot_id != state.boot_id:
        former = [boot for boot, boot_id in state.former_boots if boot_id == frame.boot_id]
        return (former[0], False) if former else (state.boot + 1, True)
    if frame.boot_id is not None or frame.sequence is None or state.sequence is None:
        return state.boot, False
    newest = max([state.sequence, *(f.sequence for f in state.held if f.sequence is not None)])
    newest_us = state.newest_us
    back = frame.sequence < newest and newest_us is not None and frame.time_us > newest_us
    return (state.boot + 1, True) if back else (state.boot, False)


def _open_boot(state: OrderState, boot: int, boot_id: str | None) -> OrderState:
    former = state.former_boots
    if state.boot_id is not None:
        former = (*former, (state.boot, state.boot_id))[-FORMER_BOOTS:]
    return replace(state, boot=boot, boot_id=boot_id, former_boots=former, sequence=None, number_offset=0)


def _place(state: OrderState, frame: Frame) -> tuple[OrderState, Admission]:
    """Release, hold or refuse a frame of the current boot that was not seen before."""
    rising = frame.sequence is not None and (state.sequence is None or frame.sequence > state.sequence)
    if frame.sequence is not None and not rising:
        return state, Admission(Fate.LATE)
    if state.time_us is not None and frame.time_us <= state.time_us:
        return _behind(state, frame) if rising else (state, Admission(Fate.LATE))
    next_in_line = state.sequence is not None and frame.sequence == state.sequence + 1 and not state.held
    if frame.sequence is None or state.sequence is None or next_in_line:
        state, released = _release(state, frame)
        return state, Admission(Fate.TRACKED, (released,))
    held = tuple(sorted((*state.held, frame), key=_sequence))
    state, admission = _drain(replace(state, held=held), REORDER_WINDOW)
    waits = any(f is frame for f in state.held)
    return state, replace(admission, fate=Fate.HELD if waits else Fate.TRACKED)


def _behind(state: OrderState, frame: Frame) -> tuple[OrderState, Admission]:
    """Refuse a frame with a rising number whose time went back; begin anew where the clock was set back."""
    if state.time_us is None or state.time_us - frame.time_us < CLOCK_STEP_US:
        return state, Admission(Fate.LATE)
    before = state.far_back
    state, flushed = flush(state)
    far_back = 1 if flushed.released else before + 1
    if far_back < CLOCK_STEP_FRAMES:
        return replace(state, far_back=far_back), replace(flushed, fate=Fate.LATE)
    fresh = OrderState(
        boot=state.boot + 1, boot_id=state.boot_id, former_boots=state.former_boots, recent=state.recent
    )
    fresh, released = _release(fresh, frame)
    return fresh, replace(flushed, released=(released,), clock_step=True)


def _drain(state: OrderState, window: int) -> tuple[OrderState, Admission]:
    """Release held frames while the next number is there, or more than `window` frames are held."""
    released: list[Released] = []
    missing = dropped = 0
    while state.held:
        frame, *rest = state.held
        step = _sequence(frame) - (state.sequence or 0)
        if step != 1 and len(state.held) <= window:
            break
        missing += step - 1
        state = replace(state, held=tuple(rest))
        if state.time_us is not None and frame.time_us <= state.time_us:
            state = replace(state, sequence=frame.sequence)
            dropped += 1
            continue
        state, one = _release(state, frame)
        released.append(one)
    return state, Admission(Fate.TRACKED, tuple(released), missing, dropped)


def _release(state: OrderState, frame: Frame) -> tuple[OrderState, Released]:
    number, offset = state.number + 1, state.number_offset
    if frame.sequence is not None:
        soon = state.time_us is not None and frame.time_us - state.time_us < _SECOND_US
        wanted = frame.sequence + offset
        if wanted >= number and not (soon and wanted - number > NUMBER_JUMP):
            number = wanted
        offset = number - frame.sequence
    state = OrderState(  # as `replace` would, in a fifth of the time
        state.boot,
        state.boot_id,
        state.former_boots,
        state.sequence if frame.sequence is None else frame.sequence,
        frame.time_us,
        number,
        offset,
        0,
        state.held,
        state.recent,
    )
    return state, Released(frame, number, state.boot)


def _sequence(frame: Frame) -> int:
    return 0 if frame.sequence is None else frame.sequence
