"""The topics that a seat reads, as a table, and what it is told of each."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple

from kontur_av.streams.coded_unit import CodedUnit
from kontur_av.topics.bus import Lease, TopicBus
from pipelines.hand.hand_topics import unpack_status
from pipelines.media.following import Choice
from pipelines.mission.tmtc_messages import unpack_news
from pipelines.seats.key_pictures import KeyPictures
from pipelines.seats.plan import Unpack
from pipelines.seats.seat import Seat
from pipelines.seats.texts import Via
from pipelines.session.feeds import Feed, TopicState
from pipelines.session.serving_loop import ServingLoop
from pipelines.session.topology import JOYSTICK_STATE_TOPIC, SELECTED_TOPIC, TMTC_TOPICS, Segment
from telepresence.link.backlog import Backlog

#: Unread samples of a topic that are kept.
_DEPTH = 8
#: As many news of telecommands and telemetry as their topic keeps.
_NEWS = 32


class _Fed(NamedTuple):
    """A topic that is read whenever there is something new.

    always: also while no page is open, for those who join.
    """

    topic: str
    handle: Callable[[Lease], None]
    depth: int = _DEPTH
    always: bool = False


class _Looked(NamedTuple):
    """A topic that changes too often to wake for it; its newest sample is read at each look."""

    topic: str
    handle: Callable[[bytes, int], None]


class SeatTopics:
    """Reads the topics of a seat.

    While nobody looks, only the units of pictures and what telecommands and telemetry bring are
    read: what is said in the chat while no page is open must not be missed.

    settle: called when the seat was told something that came by itself.
    """

    def __init__(
        self,
        seat: Seat,
        serving: ServingLoop,
        bus: TopicBus,
        keys: KeyPictures,
        *,
        now_ns: Callable[[], int],
        settle: Callable[[], None],
    ) -> None:
        self._seat, self._keys, self._now_ns, self._settle = seat, keys, now_ns, settle
        fed = list(self._fed())
        feeds = [
            Feed(serving.loop, bus, one.topic, partial(self._take, one), depth=one.depth)
            for one in fed
        ]
        self._always = [feed for feed, one in zip(feeds, fed, strict=True) if one.always]
        self._live = [feed for feed, one in zip(feeds, fed, strict=True) if not one.always]
        self._looked = [(TopicState(bus, one.topic), one.handle) for one in self._states()]

    def _fed(self) -> Iterator[_Fed]:
        plan = self._seat.plan
        yield _Fed(TMTC_TOPICS[plan.segment], self._news, _NEWS, always=True)
        for each in plan.streams:
            if each.via is Via.SOUND:
                yield _Fed(each.topic, partial(self._sound, each.index))
            else:
                yield _Fed(each.topic, partial(self._unit, each.index), always=True)
        for end, topic in plan.traces.items():
            yield _Fed(topic, partial(self._haptics, end))
        for preview in plan.previews:
            yield _Fed(preview.topic, partial(self._preview, preview.index), 1)
        if plan.segment is Segment.SPACE:
            yield _Fed(JOYSTICK_STATE_TOPIC, self._status)

    def _states(self) -> Iterator[_Looked]:
        plan, seat = self._seat.plan, self._seat
        yield _Looked(
            plan.backlog_topic,
            lambda told, now_ns: seat.handle_signal(Backlog.unpack(told).peer_heard, now_ns),
        )
        for kind, (topic, unpack) in plan.shown.items():
            yield _Looked(topic, partial(self._shown, kind, unpack))
        if plan.segment is Segment.GROUND:
            yield _Looked(
                SELECTED_TOPIC,
                lambda told, now_ns: seat.handle_camera(Choice.unpack(told).camera, now_ns),
            )

    def open(self) -> None:
        """Read what is read always."""
        for feed in self._always:
            feed.open()

    def watch(self, watching: bool) -> None:
        """Open what pages are shown with the first of them, and close it with the last."""
        read: list[Feed | TopicState] = [*self._live, *(state for state, _ in self._looked)]
        for feed in read:
            if watching:
                feed.open()
            else:
                feed.close()

    def look(self, now_ns: int) -> None:
        """Read what changes too often to wake for it."""
        for state, handle in self._looked:
            if (told := state.latest()) is not None:
                handle(told, now_ns)

    def close(self) -> None:
        """Leave all topics."""
        for feed in (*self._always, *self._live):
            feed.close()

    def _take(self, one: _Fed, lease: Lease) -> None:
        one.handle(lease)
        self._settle()

    def _unit(self, stream: int, lease: Lease) -> None:
        unit = CodedUnit.unpack(lease.octets())
        self._seat.media.handle_unit(stream, unit, lease.stamp, self._now_ns())
        self._keys.handle_unit(stream, unit, lease.stamp)

    def _sound(self, stream: int, lease: Lease) -> None:
        self._seat.media.handle_sound(stream, lease.octets(), lease.stamp)

    def _haptics(self, end: int, lease: Lease) -> None:
        self._seat.media.handle_haptics(end, lease.octets())

    def _preview(self, preview: int, lease: Lease) -> None:
        self._seat.media.handle_preview(preview, lease.video().data, lease.stamp)

    def _news(self, lease: Lease) -> None:
        if (news := unpack_news(lease.octets())) is not None:
            self._seat.handle_news(news, self._now_ns())

    def _status(self, lease: Lease) -> None:
        if (status := unpack_status(lease.octets())) is not None:
            self._seat.handle_status(status, self._now_ns())

    def _shown(self, kind: str, unpack: Unpack, told: bytes, now_ns: int) -> None:
        self._seat.handle_shown(kind, unpack(told))
