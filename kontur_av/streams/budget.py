"""The hard byte budget of a stream: which packets may leave, and when to encode the next picture.

The encoder's rate control aims at a rate, but it does not keep a limit. The pacer does: it releases
packets so that no sliding window exceeds the cap. A coded picture that would exceed it waits, in
pieces. It is not dropped, because every later picture refers to it. Instead the next picture is not
encoded while the channel is still busy with those before it.

So the channel sets the pace of encoding, not the camera (`EncodeScheduler`). A picture that is
encoded while the channel is busy waits behind the one before it, and is shown later by as much. So
the channel carries one picture while the next one is encoded. Encoding begins so that it ends when
the channel becomes free. If the newest picture is too old by then, the scheduler waits for the next
one. Encoding then keeps step with the camera while pictures are small enough, and leaves one out
where they are not. Without this rule, one large picture would delay all that follow, for as long as
pictures fill the channel.
"""

from collections import deque
from collections.abc import Sequence

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ConfigError, whole
from kontur_av.meters import RateMeter, SlidingWindow

LEAST_BPS, MOST_BPS = 1000, 1_000_000_000
SHORT_WINDOW_NS = 100_000_000
#: The limit over 100 ms, as a multiple of the share of the cap: 1.5.
SHORT_WINDOW_SHARE = (3, 2)


class _Limit(SlidingWindow):
    """At most `room_octets` over any window of `length_ns`."""

    def __init__(self, length_ns: int, room_octets: int) -> None:
        super().__init__(length_ns)
        self.room_octets = room_octets

    def room_ns(self, octets: int, now_ns: int) -> int:
        """Return from when on `octets` fit: `now_ns` or later."""
        self._forget(now_ns)
        excess = self.octets + octets - self.room_octets
        if excess <= 0:
            return now_ns
        for event_ns, event_octets in self._events:
            excess -= event_octets
            if excess <= 0:
                return event_ns + self.length_ns
        # More than the window can hold: wait until it is empty.
        return self._events[-1][0] + self.length_ns if self._events else now_ns


class Pacer:
    """Releases a stream's packets under a hard cap. A core.

    cap_bps: limit of the payload bits of released packets, over any window of `window_ns`. Over any
        100 ms the limit is 1.5 times the share of the cap. At least 1000.
    channel_bps: rate of the channel, at least the cap. Packets leave with the spacing with which
        this channel carries their payload. None: the cap.
    guard_ns: the windows are longer by this. So the cap also holds for an observer who sees the
        packets with delays that differ by less than this. 10 ms of 1 s cost 1 % of the rate.
    picture_ns: the time between two pictures, from which the size of the next one is estimated.

    Queue: packets in order. `EncodeScheduler` bounds its depth, because it encodes no picture while
    one waits. Nothing is dropped.

    Raises ConfigError for a cap or channel that cannot work.
    """

    def __init__(
        self,
        *,
        cap_bps: int,
        channel_bps: int | None = None,
        window_ns: int = NS_PER_S,
        guard_ns: int = 10_000_000,
        picture_ns: int = NS_PER_S // 30,
    ) -> None:
        cap_bps = whole(cap_bps, "cap_bps", least=LEAST_BPS, most=MOST_BPS)
        if channel_bps is not None and channel_bps < cap_bps:
            raise ConfigError(
                f"a channel of {channel_bps} bit/s cannot carry a cap of {cap_bps} bit/s: "
                "lower the cap or give the channel more"
            )
        self.cap_bps = cap_bps
        self.channel_bps = cap_bps if channel_bps is None else channel_bps
        self._window_ns = window_ns
        self._limits = (
            _Limit(SHORT_WINDOW_NS + guard_ns, _short_octets(cap_bps)),
            _Limit(window_ns + guard_ns, cap_bps * window_ns // (8 * NS_PER_S)),
        )
        #: The largest payload of a packet that fits under this cap.
        self.max_payload_octets = min(limit.room_octets for limit in self._limits)
        self._first_cap_bps, self._first_max_octets = cap_bps, self.max_payload_octets
        share = cap_bps * picture_ns // (8 * NS_PER_S)
        #: The expected size of the next picture.
        self.picture_octets = self._first_picture_octets = min(share, self.max_payload_octets)
        self._queue: deque[tuple[bytes, int, int]] = deque()
        self._backlog_octets = 0
        self._free_ns = 0
        #: What was released: packets as events, by payload octets.
        self.released = RateMeter(windows_ns=(window_ns, SHORT_WINDOW_NS))
        #: The longest that any packet waited for its release.
        self.longest_wait_ns = 0

    def follow(self, *, cap_bps: int, channel_bps: int) -> None:
        """Change cap and channel from now on.

        The next packets leave when they fit under the new cap, together with those that have left.
        New packets must fit `max_payload_octets` of a lower cap; one that waits already and is
        larger leaves when nothing has left for 100 ms. Raises ValueError for a channel below the
        cap, or a cap below the least.
        """
        if not LEAST_BPS <= cap_bps <= channel_bps:
            raise ValueError(f"cap {cap_bps}, channel {channel_bps}: at least {LEAST_BPS}")
        short, long = self._limits
        short.room_octets = _short_octets(cap_bps)
        long.room_octets = cap_bps * self._window_ns // (8 * NS_PER_S)
        # Under a higher cap packets stay as small as the first one needs.
        self.max_payload_octets = min(self._first_max_octets, short.room_octets, long.room_octets)
        self.picture_octets = self._first_picture_octets * cap_bps // self._first_cap_bps
        self.cap_bps, self.channel_bps = cap_bps, channel_bps

    def handle_access_unit(
        self, packets: Sequence[bytes], payload_octets: Sequence[int], now_ns: int
    ) -> None:
        """Queue the packets of one access unit. Then drain `poll_transmit`.

        payload_octets: of each packet; they count against the cap. Raises ValueError for a payload
        of more than `max_payload_octets`, which could never leave.
        """
        for packet, octets in zip(packets, payload_octets, strict=True):
            if octets > self.max_payload_octets:
                raise ValueError(f"payload of {octets} octets: at most {self.max_payload_octets}")
            self._queue.append((packet, octets, now_ns))
            self._backlog_octets += octets

    def poll_transmit(self, now_ns: int) -> bytes | None:
        """Return the next packet if it may leave now, else None. Call it until None."""
        if not self._queue:
            return None
        packet, octets, queued_ns = self._queue[0]
        if self._release_ns(octets, now_ns) > now_ns:
            return None
        self._queue.popleft()
        self._backlog_octets -= octets
        for limit in self._limits:
            limit.add(now_ns, octets)
        self._free_ns = max(self._free_ns, now_ns) + self._on_channel_ns(octets)
        self.released.add(now_ns, octets)
        self.longest_wait_ns = max(self.longest_wait_ns, now_ns - queued_ns)
        return packet

    def poll_timeout(self) -> int | None:
        """Return when to call `poll_transmit` next; None while nothing is queued."""
        if not self._queue:
            return None
        _, octets, queued_ns = self._queue[0]
        return self._release_ns(octets, max(queued_ns, self.released.last_ns or 0))

    def start_ns(self, now_ns: int) -> int:
        """Return when the next picture could start on the channel: `now_ns` or later."""
        wanted = self._backlog_octets + self.picture_octets
        start_ns = max(self._free_ns, now_ns) + self._on_channel_ns(self._backlog_octets)
        return max(start_ns, *(limit.room_ns(wanted, now_ns) for limit in self._limits))

    @property
    def backlog_octets(self) -> int:
        """Payload octets that wait for release."""
        return self._backlog_octets

    @property
    def depth(self) -> int:
        """Packets that wait for release."""
        return len(self._queue)

    def oldest_age_ns(self, now_ns: int) -> int:
        """Return how long the oldest packet has waited; 0 while none waits."""
        return now_ns - self._queue[0][2] if self._queue else 0

    def _release_ns(self, octets: int, now_ns: int) -> int:
        earliest_ns = max(self._free_ns, now_ns)
        return max(earliest_ns, *(limit.room_ns(octets, now_ns) for limit in self._limits))

    def _on_channel_ns(self, octets: int) -> int:
        return -(-octets * 8 * NS_PER_S // self.channel_bps)


def _short_octets(cap_bps: int) -> int:
    times, of = SHORT_WINDOW_SHARE
    return cap_bps * SHORT_WINDOW_NS * times // (of * 8 * NS_PER_S)


#: The coding time before one was measured.
_CODING_NS = 3 * NS_PER_MS
#: A new measurement counts for one part in eight of the mean.
_SMOOTHING = 8
#: The largest age of a picture at its encoding, in parts of a period: 7 ms of 33.
#: Measured: the 99th percentile 10 ms and more lower than with no such limit, at 29.5 pictures a
#: second.
_OLDEST = (22, 100)
#: The scheduler gives up waiting for a picture when it is late by this part of a period.
_GRACE_PARTS = 8
#: When to look again whether a channel that is behind has caught up.
_LOOK_AGAIN_NS = 2 * NS_PER_MS
#: The rate of the camera is a mean over this many pictures. A faster camera is noticed sooner,
#: because then each picture is too large.
_COUNTED = 45
_COUNTED_FASTER = 15
#: A rate that differs by this factor is another one.
_OTHER_RATE = 1.08


class EncodeScheduler:
    """Decides which pictures of a stream to encode, and when. A core.

    Call `handle_picture` for each picture. Then, and at `poll_timeout`, call `poll_encode`. Call
    `handle_encoded` when the coding is done; until then no other picture is encoded.

    pacer: of the stream. fps: the picture rate for which the encoder was made. camera_hz: of the
        camera, if it is higher. Then pictures between those of the encoder are left out.
    """

    def __init__(self, pacer: Pacer, *, fps: float, camera_hz: float | None = None) -> None:
        self._pacer = pacer
        self._fps = fps
        self._told_hz = fps
        self._camera_hz = max(camera_hz or fps, fps)
        #: Of the camera.
        self._period_ns = round(NS_PER_S / self._camera_hz)
        self._coding_ns = _CODING_NS
        #: When the newest picture came, and whether it waits for a decision.
        self._came_ns = 0
        self._waits = False
        #: When the present encoding began.
        self._begun_ns: int | None = None
        self._waiting_octets = self._channel_free_ns = 0
        self._now_ns = 0
        self._counted_since_ns: int | None = None
        self._last_ns: int | None = None
        self._counted = self._longest_ns = 0
        self._new_hz: float | None = None
        #: Pictures that came, and those of them that are never encoded.
        self.captured = self.refused = 0

    def handle_channel(self, octets: int, rate_bps: int, told_ns: int) -> None:
        """At `told_ns`, this many octets waited behind the pacer, in a channel of this rate."""
        self._waiting_octets = octets
        self._channel_free_ns = told_ns + octets * 8 * NS_PER_S // rate_bps

    def handle_picture(self, capture_ns: int, now_ns: int, *, skipped: int = 0) -> None:
        """A new picture came. It replaces one that still waits.

        skipped: pictures before it that the caller left out.
        """
        self.captured += 1 + skipped
        self.refused += skipped + self._waits
        self._came_ns, self._waits = now_ns, True
        self._now_ns = now_ns
        self._count(capture_ns, 1 + skipped)

    def poll_encode(self, now_ns: int) -> bool:
        """Return whether to encode the newest picture now."""
        self._now_ns = now_ns
        due_ns = self._due_ns()
        if due_ns is None or due_ns > now_ns:
            return False
        self._waits = False
        self._begun_ns = now_ns
        return True

    def poll_timeout(self) -> int | None:
        """Return when to call `poll_encode` next.

        None while no picture waits, or while one is being encoded.
        """
        return self._due_ns()

    def handle_encoded(self, now_ns: int) -> None:
        """The picture is encoded. Raises ValueError if `poll_encode` asked for none."""
        if self._begun_ns is None:
            raise ValueError("no picture was to be encoded")
        self._coding_ns += (now_ns - self._begun_ns - self._coding_ns) // _SMOOTHING
        self._begun_ns = None

    def finish(self) -> None:
        """Encode no more pictures; one that waits is refused."""
        self.refused += self._waits
        self._waits = False

    def next_rate_hz(self) -> float | None:
        """Return the measured picture rate if the encoder should change to it, else None."""
        hz, self._new_hz = self._new_hz, None
        return hz

    def _due_ns(self) -> int | None:
        if not self._waits or self._begun_ns is not None:
            return None
        free_ns = max(self._pacer.start_ns(self._now_ns), self._channel_free_ns)
        due_ns = max(free_ns - self._coding_ns, self._came_ns)
        if self._waiting_octets > self._pacer.picture_octets:
            # The channel may carry less than its rate: measured; it cannot be computed.
            due_ns = max(due_ns, self._now_ns + _LOOK_AGAIN_NS)
        next_ns = self._came_ns + self._period_ns
        give_up_ns = next_ns + self._period_ns // _GRACE_PARTS
        parts, of = _OLDEST
        if (due_ns - self._came_ns) * of > self._period_ns * parts:
            return max(due_ns, give_up_ns)
        return due_ns

    def _count(self, capture_ns: int, pictures: int) -> None:
        since_ns, last_ns = self._counted_since_ns, self._last_ns
        self._last_ns = capture_ns
        if since_ns is None or last_ns is None or capture_ns <= last_ns:
            self._counted_since_ns, self._counted, self._longest_ns = capture_ns, 0, 0
            return
        self._counted += pictures
        self._longest_ns = max(self._longest_ns, capture_ns - last_ns)
        mean_ns = (capture_ns - since_ns) // self._counted
        camera_hz = min(NS_PER_S / mean_ns, self._camera_hz)
        hz = min(camera_hz, self._fps)
        faster = hz > self._told_hz * _OTHER_RATE
        if self._counted < (_COUNTED_FASTER if faster else _COUNTED):
            return
        # A slow camera is regular; an overloaded machine is not.
        regular = self._longest_ns < 3 * mean_ns // 2
        slower = regular and hz * _OTHER_RATE < self._told_hz
        self._counted_since_ns, self._counted, self._longest_ns = capture_ns, 0, 0
        if faster or slower:
            self._told_hz = self._new_hz = round(hz, 1)
        # Between the encoder's rate and the camera's, only the period changes.
        periods = self._period_ns * camera_hz / NS_PER_S
        other = not 1 / _OTHER_RATE < periods < _OTHER_RATE
        if faster or slower or (regular and other):
            self._period_ns = round(NS_PER_S / camera_hz)
