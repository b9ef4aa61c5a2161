"""Open pages of a seat: how much they may send, what waits for them, and their media. Cores.

The queue is bounded, whatever the page does.

| what | depth | when it is full |
|---|---|---|
| answers | 64 | the page is closed: it asks and does not read |
| pongs | 32 | the oldest is dropped |
| state, each kind of the mission's texts, each preview | 1 | the newest replaces it |
| figures | 8 | the oldest is dropped |
| haptics, of each end | 25 blocks, 0.5 s | the oldest is dropped |
| sound, of each stream | 15 blocks, 0.3 s | the oldest is dropped, and counted |
| units, of each picture | 45 or 1 MiB | all are dropped and counted; see `Lane` |

They are sent in this order: pongs, answers, state, sound, haptics, units, the mission's
texts, figures, previews.
A replay is a key picture and the units since, and there is one at a time of a stream.
"""

from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from kontur_av.clock import NS_PER_S, NS_PER_US
from kontur_av.media import I420, CaptureStamp, Quality
from kontur_av.streams.coded_unit import CodedUnit
from pipelines.hand.haptic_trace import rows_of
from pipelines.media.joined_units import JoinedUnits, StreamUnit
from pipelines.seats.plan import SeatStream
from pipelines.seats.texts import Via
from pipelines.session.access import Role
from pipelines.session.page_messages import (
    DAMAGED,
    KEY,
    REPLAYED,
    UNKNOWN_US,
    pack_haptic,
    pack_preview,
    pack_sound,
    pack_unit,
)


class MessageRate:
    """Permits `rate_hz` messages a second on average, and bursts of up to `burst`."""

    def __init__(self, rate_hz: int, burst: int) -> None:
        # In shares of a message, so that all is exact in integers.
        self._rate_hz = rate_hz
        self._most = burst * NS_PER_S
        self._tokens = self._most
        self._last_ns: int | None = None

    def handle_message(self, now_ns: int) -> bool:
        """Return whether a message of this instant is within the rate."""
        if self._last_ns is not None:
            self._tokens += max(0, now_ns - self._last_ns) * self._rate_hz
        self._last_ns = now_ns
        self._tokens = min(self._tokens, self._most)
        if self._tokens < NS_PER_S:
            return False
        self._tokens -= NS_PER_S
        return True


_MOST_ANSWERS = 64
_MOST_PONGS = 32
_MOST_METRICS = 8
_MOST_HAPTICS = 25
_MOST_SOUNDS = 15
MOST_UNITS = 45
MOST_UNIT_OCTETS = 1 << 20

Message = bytes | str


class Lane:
    """Units of one stream on their way to one page.

    Each unit refers to the one before, so none may be missing. If they do not fit, all are dropped
    and the gate closes. It opens again with a key unit, or with a replay.

    open: units pass. begun: they have passed before.
    left_out: units that were dropped because the page was too slow.
    """

    def __init__(self) -> None:
        self.open = False
        self.left_out = 0
        self.begun = False
        self._replay: deque[bytes] = deque()
        self._units: deque[bytes] = deque()
        self._octets = 0

    def __len__(self) -> int:
        return len(self._replay) + len(self._units)

    def put_replay(self, messages: Iterable[bytes]) -> None:
        self._clear()
        self._replay.extend(messages)
        self.open = self.begun = True

    def put_unit(self, message: bytes, *, key: bool) -> None:
        """Put a unit behind those that wait, if the gate is open, or opens with it."""
        if not self.open and self.begun and key:
            self.open = True
        if not self.open:
            # Before its first picture a page is not slow, it only waits.
            self.left_out += self.begun
            return
        full = len(self._units) >= MOST_UNITS or self._octets + len(message) > MOST_UNIT_OCTETS
        if self._units and full:
            self.left_out += len(self) + 1
            self._clear()
            self.open = False
            return
        self._units.append(message)
        self._octets += len(message)

    def pop(self) -> bytes | None:
        if self._replay:
            return self._replay.popleft()
        if not self._units:
            return None
        message = self._units.popleft()
        self._octets -= len(message)
        return message

    def _clear(self) -> None:
        self._replay.clear()
        self._units.clear()
        self._octets = 0


class ClientQueue:
    """What waits to be sent to one page. Take it with `pop` when the page can take more.

    lanes: by index of a stream of pictures.
    overflowed: the page asks and does not read; close it.
    sound_left_out: blocks that were dropped because the page was too slow.
    """

    def __init__(self, lanes: Iterable[int]) -> None:
        self.overflowed = False
        self.sound_left_out = 0
        self.lanes = {index: Lane() for index in lanes}
        self._answers: deque[str] = deque()
        self._pongs: deque[bytes] = deque(maxlen=_MOST_PONGS)
        self._state: deque[str] = deque(maxlen=1)
        self._newest: dict[str, str] = {}
        self._metrics: deque[str] = deque(maxlen=_MOST_METRICS)
        self._haptics: dict[int, deque[bytes]] = {}
        self._sounds: dict[int, deque[bytes]] = {}
        self._previews: dict[int, bytes] = {}
        self.put_pong, self.put_state = self._pongs.append, self._state.append
        self.put_metrics = self._metrics.append

    def __len__(self) -> int:
        others = len(self._newest) + len(self._metrics) + len(self._previews)
        return others + sum(map(len, self._urgent)) + sum(map(len, self.lanes.values()))

    @property
    def _urgent(self) -> list[deque[bytes] | deque[str]]:
        blocks = (*self._sounds.values(), *self._haptics.values())
        return [self._pongs, self._answers, self._state, *blocks]

    @property
    def units_left_out(self) -> int:
        """Units and blocks of sound that were dropped because the page was too slow."""
        return self.sound_left_out + sum(lane.left_out for lane in self.lanes.values())

    def put_answer(self, text: str) -> None:
        """A text that must not be lost."""
        if len(self._answers) >= _MOST_ANSWERS:
            self.overflowed = True
        else:
            self._answers.append(text)

    def put_newest(self, kind: str, text: str) -> None:
        """A text that holds all that is known of its kind."""
        self._newest[kind] = text

    def put_haptics(self, end: int, message: bytes) -> None:
        self._haptics.setdefault(end, deque(maxlen=_MOST_HAPTICS)).append(message)

    def put_preview(self, preview: int, message: bytes) -> None:
        self._previews[preview] = message

    def put_sound(self, stream: int, message: bytes) -> None:
        sounds = self._sounds.setdefault(stream, deque())
        if len(sounds) >= _MOST_SOUNDS:
            sounds.popleft()
            self.sound_left_out += 1
        sounds.append(message)

    def pop(self) -> Message | None:
        """Return the next message, the most urgent first; None if nothing waits."""
        for line in self._urgent:
            if line:
                return line.popleft()
        for lane in self.lanes.values():
            if (unit := lane.pop()) is not None:
                return unit
        for kind in self._newest:
            return self._newest.pop(kind)
        if self._metrics:
            return self._metrics.popleft()
        for preview in self._previews:
            return self._previews.pop(preview)
        return None


_TEXT_HZ = _PING_HZ = 20
_HAND_HZ = 1200


@dataclass
class PageTalker:
    """A socket of a page: who is there, and how much it may send."""

    role: Role
    texts: MessageRate = field(default_factory=lambda: MessageRate(_TEXT_HZ, _TEXT_HZ))
    pings: MessageRate = field(default_factory=lambda: MessageRate(_PING_HZ, _PING_HZ))


@dataclass(kw_only=True)
class OpenPage(PageTalker):
    """A page that is open. plain: without pictures, sound and haptics. name: who sits there.

    idle: it has taken all that there was, so it would take more at once.
    """

    number: int
    queue: ClientQueue
    name: str = ""
    plain: bool = False
    idle: bool = True
    hands: MessageRate = field(default_factory=lambda: MessageRate(_HAND_HZ, _HAND_HZ))


class SeatMedia:
    """Passes media on to pages, and has a page's decoder begin with a key picture. A core.

    pages: those that are open, by number.
    """

    def __init__(self, streams: Sequence[SeatStream], pages: Mapping[int, OpenPage]) -> None:
        self._pages = pages
        self._streams = {each.index: JoinedUnits() for each in streams if each.via is not Via.SOUND}

    @property
    def lanes(self) -> list[int]:
        """Indices of the streams of pictures."""
        return list(self._streams)

    def handle_unit(self, stream: int, unit: CodedUnit, stamp: CaptureStamp, now_ns: int) -> None:
        waiting = self._waiting(stream)
        joined = self._streams[stream].handle_unit(unit, stamp, now_ns, waits=bool(waiting))
        for page in self._seeing() if joined.anew else ():
            page.queue.lanes[stream].open = False
        if joined.live is not None:
            message = _packed(stream, joined.live)
            for page in self._seeing():
                if page.queue.lanes[stream].open or not page.idle:
                    page.queue.lanes[stream].put_unit(message, key=unit.key)
        if joined.begin:
            *before, last = joined.begin
            messages = [*(_packed(stream, each, REPLAYED) for each in before)]
            for page in waiting:
                page.queue.lanes[stream].put_replay([*messages, _packed(stream, last)])

    def poll_asks(self, now_ns: int) -> list[int]:
        """Return the streams whose coders are to be asked for a key picture."""
        return [
            index
            for index, joined in self._streams.items()
            if joined.poll_ask(now_ns, waits=bool(self._waiting(index)))
        ]

    def handle_sound(self, stream: int, samples: bytes, stamp: CaptureStamp) -> None:
        message = pack_sound(
            stream,
            stamp.sequence,
            stamp.capture_ns // NS_PER_US,
            samples,
            concealed=stamp.quality is Quality.CONCEALED,
        )
        for page in self._seeing():
            page.queue.put_sound(stream, message)

    def handle_haptics(self, end: int, block: bytes) -> None:
        message = pack_haptic(end, rows_of(block))
        for page in self._seeing():
            page.queue.put_haptics(end, message)

    def handle_preview(self, preview: int, picture: I420, stamp: CaptureStamp) -> None:
        message = pack_preview(preview, stamp.capture_ns // NS_PER_US, picture)
        for page in self._seeing():
            page.queue.put_preview(preview, message)

    def _seeing(self) -> list[OpenPage]:
        """Pages with pictures, sound and haptics."""
        return [page for page in self._pages.values() if not page.plain]

    def _waiting(self, stream: int) -> list[OpenPage]:
        """Pages that can begin with a stream; one that was too slow has to take all before."""
        lanes = [(page, page.queue.lanes[stream]) for page in self._seeing()]
        return [page for page, lane in lanes if not lane.open and (page.idle or not lane.begun)]


def _packed(stream: int, came: StreamUnit, more_flags: int = 0) -> bytes:
    unit, stamp = came.unit, came.stamp
    damaged = unit.damaged or stamp.quality is Quality.DAMAGED
    flags = KEY * unit.key | DAMAGED * damaged | more_flags
    capture_us = stamp.capture_ns // NS_PER_US if unit.dated else UNKNOWN_US
    return pack_unit(stream, flags, stamp.sequence, capture_us, came.data)
