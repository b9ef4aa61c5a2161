"""A running session from another program: what the operator sees, what hands feel, telecommands.

Use::

    with JoinedSession() as session:
        for picture in session.pictures():
            show(picture.data, picture.age_ms)
        print(session.select("static").round_trip_ms)
"""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from random import SystemRandom
from typing import Any, Generic, Literal, Self, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from kontur_av.clock import NS_PER_MS, MonotonicClock
from kontur_av.closing import Closing
from kontur_av.errors import ConfigError
from kontur_av.media import CaptureStamp, Quality
from kontur_av.topics.bus import Lease, TopicBus, Writer
from kontur_av.topics.session_files import choose_session
from pipelines.hand.haptic_trace import JOYSTICK_TRACE_TOPIC, ROBOT_TRACE_TOPIC, rows_of
from pipelines.mission.choosing import CAMERA, SELECT
from pipelines.mission.driving import Driving
from pipelines.mission.tmtc_messages import CommandUpdate, command_from_words
from pipelines.mission.tmtc_socket import TMTC_SOCKETS, Sending, read_dictionary, tmtc_socket_name
from pipelines.session.requests import running_sessions
from pipelines.session.setup.segments import Segment
from pipelines.session.topology.topics import displayed_topic, page_topic

_CLIENT = "JoinedSession"
_LOOK_NS = 200 * NS_PER_MS
_LOOK_S = 0.2
_DEPTH = 32
_TRACES = {"robot": ROBOT_TRACE_TOPIC, "joystick": JOYSTICK_TRACE_TOPIC}

_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class ShownPicture:
    """A picture on a display of the session.

    data: RGB, shape (height, width, 3), uint8.
    age_ms: since its capture, at the moment of handing over. captured_ns: of the monotonic clock.
    """

    data: NDArray[np.uint8]
    age_ms: float
    quality: Quality
    captured_ns: int = 0


class TopicFeed(Generic[_T]):
    """What comes of one topic: an iterator, sync or async. It ends with the session.

    A slow reader gets the newest picture, and the newest 32 blocks of samples.
    ended: why there is no more.
    """

    ended = ""

    def __init__(
        self, bus: TopicBus, topic: str, *, newest: bool, make: Callable[[Lease], _T], name: str
    ) -> None:
        self._reader = bus.reader(topic, depth=1 if newest else _DEPTH)
        self._waiter = bus.waiter([self._reader])
        self._newest, self._make, self._name = newest, make, name

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> _T:
        while True:
            found = self._take()
            if found is not None:
                return found
            if not self._waiter.wait(_LOOK_NS) and self._name not in _running():
                self.ended = f"session {self._name} has ended"
                raise StopIteration

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> _T:
        loop, woken = asyncio.get_running_loop(), asyncio.Event()
        loop.add_reader(self._waiter.fileno(), woken.set)
        try:
            while True:
                self._waiter.wait(0)
                woken.clear()
                found = self._take()
                if found is not None:
                    return found
                try:
                    async with asyncio.timeout(_LOOK_S):
                        await woken.wait()
                except TimeoutError:
                    if self._name not in _running():
                        self.ended = f"session {self._name} has ended"
                        raise StopAsyncIteration from None
        finally:
            loop.remove_reader(self._waiter.fileno())

    def latest(self) -> _T | None:
        """Return what is new, or None; it never waits."""
        return self._take()

    def _take(self) -> _T | None:
        lease = self._reader.latest() if self._newest else self._reader.next()
        if lease is None:
            return None
        with lease:
            return self._make(lease)


class GivenInput:
    """Fills one input of a session, in the place of its own source while something comes."""

    def __init__(self, bus: TopicBus, name: str) -> None:
        self._bus, self._name = bus, name
        self._topic = page_topic(name)
        # An input that the session does not have is refused at once.
        bus.reader(self._topic).close()
        self._writer: Writer | None = None
        self._count = 0

    def send(self, data: NDArray[np.uint8] | NDArray[np.int16], capture_ns: int) -> None:
        """Give a picture or 20 ms of sound, which was captured at `capture_ns`.

        data: RGB, of the input's size, shape (height, width, 3), uint8; or mono, 48 kHz, shape
        (960,), int16. capture_ns: of the monotonic clock, at most 0.5 s (sound: 0.2 s) ago.
        """
        stamp = CaptureStamp(capture_ns, self._count, self._name)
        self._count += 1
        if self._writer is None:
            octets = data.nbytes if data.ndim == 1 else data.nbytes // 2
            self._writer = self._bus.writer(self._topic, max_octets=octets)
        if data.ndim == 1:
            self._writer.publish_octets(data.astype(np.int16, copy=False).tobytes(), stamp)
            return
        loan = self._writer.loan_picture(data.shape[1], data.shape[0])
        cv2.cvtColor(data, cv2.COLOR_RGB2YUV_I420, dst=loan.picture)
        loan.publish(stamp)


class JoinedSession(Closing):
    """A session of this user on this machine. A context manager, sync or async.

    name: of the session or of its setup; None: the only one. Raises ConfigError if none fits.
    A slow reader never delays the session.
    """

    def __init__(self, name: str | None = None) -> None:
        #: Its name.
        self.name = choose_session(name, _running())
        self._bus = TopicBus.join(self.name)
        self._clock = MonotonicClock()

    def pictures(self, stream: str = "uplink_video") -> TopicFeed[ShownPicture]:
        """What the display of a video stream shows: always the newest picture.

        stream: uplink_video is what the operator sees. Raises ConfigError if there is none.
        """
        topic = displayed_topic(stream)
        return TopicFeed(self._bus, topic, newest=True, make=self._picture, name=self.name)

    def samples(self, end: Literal["robot", "joystick"]) -> TopicFeed[NDArray[np.void]]:
        """The haptic samples of an end as blocks of 20 rows, 1000 rows a second.

        A row, of dtype `pipelines.hand.haptic_trace.ROW`: time_ns (ns, the monotonic clock), x_m,
        y_m (m, of the tip or the handle), fx_n, fy_n (N, of the board on the tip, or displayed by
        the handle), energy_uj (µJ), flags (bit 0 contact, 1 dead-man button, 2 passivity), sent,
        received (numbers of samples, -1: none).
        """
        return TopicFeed(
            self._bus,
            _TRACES[end],
            newest=False,
            make=lambda lease: rows_of(lease.octets()),
            name=self.name,
        )

    def input(self, name: str) -> GivenInput:
        """An input to fill, such as head with `--source head=topic`; ConfigError if it is unknown.

        In a session with pages any other source gives way, too, while something comes.
        """
        return GivenInput(self._bus, name)

    def drive(self, policy: Any, *, name: str = "", hz: float = 20.0, shadow: bool = False) -> None:
        """Call `policy.step` with an `Observation` `hz` times a second, until the session ends.

        It returns where the robot is to be, as `taken_action` of `telepresence` takes it. A person
        hands the handle over at a page or by `tc joystick policy`, and any takes it back. A step
        that fails lets go, with one line; so does a silent one. name: its class by default.
        """
        with Driving(self, name or type(policy).__name__, hz=hz, shadow=shadow) as driving:
            while driving.wait():
                driving.step(policy.step)

    def select(self, camera: str) -> CommandUpdate:
        """Select the camera of the uplink, and wait for the ground's answer; as `command`."""
        return self.command(CAMERA, SELECT, camera)

    def command(self, application: str, *words: str) -> CommandUpdate:
        """Send a telecommand, and wait for its verification, as `kontur-av tc`.

        words: such as "halt", or "set", "limit=3". `ok` says whether it was carried out, `reason`
        why not. Raises ConfigError for what the application does not know, and ConnectionError if
        the session does not answer.
        """
        known = read_dictionary(self.name).application(application)
        number = SystemRandom().getrandbits(48)
        request = command_from_words(known, words, client=_CLIENT, number=number)
        end = Segment(known.end)
        # On a machine of its own, an end sends it to its own application.
        across = self.name in running_sessions(tmtc_socket_name(end.peer))
        origin = end.peer if across else end
        # A bus of its own, because the caller may be a thread.
        with TopicBus.join(self.name) as bus:
            sending = Sending(self.name, origin, request, bus)
            for _ in sending.news():
                pass
        if sending.done is None:
            raise ConnectionError(f"session {self.name} has not answered")
        if sending.done.mistake:
            raise ConfigError(sending.done.reason)
        return sending.done

    async def aselect(self, camera: str) -> CommandUpdate:
        """As `select`, in an event loop."""
        return await asyncio.to_thread(self.select, camera)

    async def acommand(self, application: str, *words: str) -> CommandUpdate:
        """As `command`, in an event loop."""
        return await asyncio.to_thread(self.command, application, *words)

    def close(self) -> None:
        """Leave the session."""
        self._bus.close()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        self.close()

    def _picture(self, lease: Lease) -> ShownPicture:
        frame = lease.video()
        return ShownPicture(
            cv2.cvtColor(frame.data, cv2.COLOR_YUV2RGB_I420).astype(np.uint8, copy=False),
            (self._clock.now_ns() - frame.stamp.capture_ns) / NS_PER_MS,
            frame.stamp.quality,
            frame.stamp.capture_ns,
        )


def _running() -> list[str]:
    return running_sessions(*TMTC_SOCKETS)
