"""When to encode: the channel sets the pace, not the camera.

A picture that is encoded while the channel is busy waits behind the one before it, and is shown
later by as much. So the channel carries one picture while the next one is encoded. Encoding begins
so that it ends when the channel becomes free. If the newest picture is too old by then, the
scheduler waits for the next one. Encoding then keeps step with the camera while pictures are small
enough, and leaves one out where they are not. Without this rule, one large picture would delay all
that follow, for as long as pictures fill the channel.
"""

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.streams.budget import Pacer

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
