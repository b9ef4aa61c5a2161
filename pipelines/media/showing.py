"""A segment's display and loudspeaker: what is shown, its age, what to draw or keep; who looks."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.detect import Click, ClickDetector, Light, LightDetector
from kontur_av.media import BLOCK_NS, I420, CaptureStamp, Pcm, Quality
from kontur_av.streams.staleness import FROZEN_PERIODS, Staleness
from pipelines.media.media_metrics import DisplayMetrics
from pipelines.session.probe import Probe
from pipelines.session.session_metrics import ClickRow, LightRow, ShownRow
from pipelines.session.setup.composition import STEREO
from pipelines.session.setup.segments import Segment
from pipelines.session.setup.table import Setup, VideoStream, VoiceStream
from pipelines.session.topology.rows import VideoRow
from pipelines.session.topology.table import Topology

#: How often the age on a stale picture is drawn anew.
REDRAW_NS = 100 * NS_PER_MS


class Drawing(NamedTuple):
    """Draw the newest picture of `stream`; stale_ns: its age for the mark, None for no mark."""

    stream: str
    stale_ns: int | None


class Screen:
    """Draws each picture when it comes, and a stale one again and again with its age. A core.

    Call `handle_picture` when `staleness` knows the picture, and `handle_time` at `poll_timeout`.
    Then draw what `next_event` returns.
    """

    def __init__(self, stream: str, staleness: Staleness) -> None:
        self._stream = stream
        self._staleness = staleness
        self._capture_ns = 0
        self._drawn_ns: int | None = None
        self._drawing: Drawing | None = None

    def handle_picture(self, capture_ns: int, now_ns: int) -> None:
        """A picture that was captured at `capture_ns` is shown from `now_ns` on."""
        self._capture_ns = capture_ns
        self._draw(now_ns)

    def poll_timeout(self) -> int | None:
        """Return when the mark is due next; None while there is no picture."""
        stale_from_ns = self._staleness.stale_from_ns()
        if stale_from_ns is None or self._drawn_ns is None:
            return None
        return max(stale_from_ns, self._drawn_ns + REDRAW_NS)

    def handle_time(self, now_ns: int) -> None:
        """Draw the mark if it is due."""
        due_ns = self.poll_timeout()
        if due_ns is not None and now_ns >= due_ns:
            self._draw(now_ns)

    def next_event(self) -> Drawing | None:
        drawing, self._drawing = self._drawing, None
        return drawing

    def _draw(self, now_ns: int) -> None:
        self._drawn_ns = now_ns
        stale_from_ns = self._staleness.stale_from_ns()
        stale = stale_from_ns is not None and now_ns >= stale_from_ns
        self._drawing = Drawing(self._stream, now_ns - self._capture_ns if stale else None)


class Showing:
    """Counts what is shown of `streams`, follows its age, and says what to draw. A core.

    After each input draw what `next_event` returns, until None. Call `handle_time` at
    `poll_timeout`.
    """

    def __init__(
        self, setup: Setup, streams: Sequence[VideoStream | VoiceStream], probe: Probe
    ) -> None:
        self.probe = probe
        self._shown = {stream.name: 0 for stream in streams}
        #: By stream.
        self.staleness = {stream.name: _staleness(setup, stream) for stream in streams}
        self._screens = {
            stream.name: Screen(stream.name, self.staleness[stream.name])
            for stream in streams
            if isinstance(stream, VideoStream)
        }

    def handle_shown(self, stream: str, stamp: CaptureStamp, now_ns: int) -> None:
        """A picture, or a block of sound, is shown at `now_ns`.

        Concealed sound does not count, and does not lower the age.
        """
        self._count(stream, stamp, now_ns)
        screen = self._screens.get(stream)
        if screen is not None:
            screen.handle_picture(stamp.capture_ns, now_ns)

    def poll_timeout(self) -> int | None:
        """Return when the next mark on a stale picture is due; None while there is no picture."""
        due = [screen.poll_timeout() for screen in self._screens.values()]
        return min((due_ns for due_ns in due if due_ns is not None), default=None)

    def handle_time(self, now_ns: int) -> None:
        """Draw the marks that are due."""
        for screen in self._screens.values():
            screen.handle_time(now_ns)

    def next_event(self) -> Drawing | None:
        for screen in self._screens.values():
            drawing = screen.next_event()
            if drawing is not None:
                return drawing
        return None

    def _count(self, stream: str, stamp: CaptureStamp, now_ns: int) -> None:
        if stamp.quality is Quality.CONCEALED or stamp.rtp_timestamp is None:
            return
        self._shown[stream] += 1
        damaged = stamp.quality is Quality.DAMAGED
        self.staleness[stream].handle_shown(stamp.capture_ns, now_ns, damaged=damaged)
        row = ShownRow(stamp.rtp_timestamp, stamp.capture_ns, now_ns)
        self.probe.series(ShownRow, stream).add(row)

    def publish(self, now_ns: int) -> None:
        """Put the counters into the probe. `handle_shown` was called for all up to `now_ns`."""
        for stream, staleness in self.staleness.items():
            staleness.handle_time(now_ns)
            stale, frozen, damaged = staleness.stale, staleness.frozen, staleness.damaged
            told = DisplayMetrics(
                frames_displayed=self._shown[stream],
                stale_ns=stale.total_ns,
                stale_episodes=stale.episodes,
                frozen_ns=frozen.total_ns,
                frozen_episodes=frozen.episodes,
                damaged_ns=damaged.total_ns,
                damaged_episodes=damaged.episodes,
                age_ns=staleness.age_ns(now_ns),
                state=staleness.state(now_ns),
            )
            self.probe.publish(told, stream)


def _staleness(setup: Setup, stream: VideoStream | VoiceStream) -> Staleness:
    stale_after_ns = setup.stale_after_ns(stream)
    if isinstance(stream, VideoStream):
        frozen_after_ns = round(FROZEN_PERIODS * NS_PER_S / stream.coded_hz)
        return Staleness(stale_after_ns=stale_after_ns, frozen_after_ns=frozen_after_ns)
    return Staleness(stale_after_ns=stale_after_ns, span_ns=BLOCK_NS)


#: The stream in which to look for lights, and the one in which to listen for clicks.
WATCHED = {"light": "uplink_video", "click": "uplink_voice"}
OPERATORS = frozenset(WATCHED.values())


class Watching:
    """Looks for lights and clicks. Pass it every picture and every block of sound of a display."""

    def __init__(self, probe: Probe) -> None:
        self._probe = probe
        self._eyes: defaultdict[str, LightDetector] = defaultdict(LightDetector)
        self._ears: defaultdict[str, ClickDetector] = defaultdict(ClickDetector)

    def handle_picture(self, stream: str, picture: I420, stamp: CaptureStamp, now_ns: int) -> None:
        """A picture of `stream`, shape (height * 3 // 2, width), is shown at `now_ns`."""
        eye = self._eyes[stream]
        eye.handle_picture(picture, now_ns, stamp.capture_ns)
        while (light := eye.next_event()) is not None:
            publish_light(self._probe, stream, light, _ITSELF)

    def handle_sound(self, stream: str, samples: Pcm, stamp: CaptureStamp, now_ns: int) -> None:
        """A block of sound of `stream` is heard from `now_ns` on."""
        ear = self._ears[stream]
        ear.handle_block(samples, now_ns, stamp.capture_ns)
        while (click := ear.next_event()) is not None:
            publish_click(self._probe, stream, click, _ITSELF)


class _Itself(dict[int, int]):
    """Tags that are capture instants already."""

    def __missing__(self, tag: int) -> int:
        return tag


_ITSELF = _Itself()


def publish_light(probe: Probe, stream: str, light: Light, captured_ns: Mapping[int, int]) -> None:
    """Put a light into the probe. captured_ns: when the pictures were captured, by their tags."""
    try:
        capture_ns = captured_ns[light.tag]
        slack_ns = max(0, capture_ns - captured_ns[light.previous_tag])
    except KeyError:
        # A picture without a capture time was not shown.
        return
    row = LightRow(light.instant_ns, capture_ns, slack_ns, round(light.strength))
    probe.series(LightRow, stream).add(row)


def publish_click(probe: Probe, stream: str, click: Click, captured_ns: Mapping[int, int]) -> None:
    """Put a click into the probe. captured_ns: when the blocks were captured, by their tags."""
    try:
        capture_ns = captured_ns[click.tag]
    except KeyError:
        return
    # Scaled to the captured block, because the playout stretches and shortens blocks.
    capture_ns += click.offset_ns * BLOCK_NS // click.length_ns
    row = ClickRow(click.instant_ns, capture_ns, 0, round(click.strength))
    probe.series(ClickRow, stream).add(row)


class Recall:
    """When the newest pictures or blocks were captured, by their RTP timestamps."""

    def __init__(self, depth: int = 64) -> None:
        self._depth = depth
        self.captured_ns: dict[int, int] = {}

    def add(self, timestamp: int, capture_ns: int) -> None:
        self.captured_ns[timestamp] = capture_ns
        if len(self.captured_ns) > self._depth:
            del self.captured_ns[next(iter(self.captured_ns))]


_FIRST_NS = NS_PER_S
_SHORTEST_INTERVAL_NS = 3 * NS_PER_S
#: The interval is this part of the session's age: thirty snapshots in an hour, 45 in a day.
_INTERVAL_SHARE = 4


class Snapshot(NamedTuple):
    """A picture to keep: its file's name without suffix, its topic, and whether to keep its halves
    as files of their own, too."""

    name: str
    topic: str
    halves: bool


class SnapshotSchedule:
    """Asks for a picture of each display and composed camera, at growing intervals. A core.

    Call `handle_time` at `poll_timeout`, then drain `next_event`.

    started_ns: when the session began. The instants are the same for every start of the process, so
    a restart repeats none. A name ends with the second of the session at which it was due.
    """

    def __init__(self, topology: Topology, *, started_ns: int, now_ns: int) -> None:
        self._started_ns = started_ns
        self._topics = {
            f"{row.direction.receiver.value}-{row.name}": row.displayed_topic
            for row in topology.media_streams
            if isinstance(row, VideoRow) and topology.runs(row.display)
        }
        ground = Segment.GROUND.value
        self._stereo = f"{ground}-{STEREO}"
        if Segment.GROUND in topology.segments:
            self._topics |= {f"{ground}-{row.name}": row.topic for row in topology.composed}
        self._due_ns = _next_ns(now_ns - started_ns)
        self._snapshots: list[Snapshot] = []

    def poll_timeout(self) -> int:
        """Return when the next snapshots are due."""
        return self._started_ns + self._due_ns

    def handle_time(self, now_ns: int) -> None:
        """Ask for the snapshots that are due; those that were missed are left out."""
        if now_ns < self.poll_timeout():
            return
        second = f"{self._due_ns // NS_PER_S:04d}s"
        self._snapshots = [
            Snapshot(f"{name}-{second}", topic, halves=name == self._stereo)
            for name, topic in reversed(self._topics.items())
        ]
        self._due_ns = _next_ns(now_ns - self._started_ns)

    def next_event(self) -> Snapshot | None:
        return self._snapshots.pop() if self._snapshots else None


def _next_ns(session_ns: int) -> int:
    """Return when the next snapshot is due after `session_ns`, both since the session's start."""
    due_ns = _FIRST_NS
    while due_ns <= session_ns:
        due_ns += max(_SHORTEST_INTERVAL_NS, due_ns // _INTERVAL_SHARE)
    return due_ns
