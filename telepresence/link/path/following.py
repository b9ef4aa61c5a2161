"""What the path to the peer carries, and what of the profile may go over it. Cores.

The receiving end measures (`Arrivals`) and tells the sending end (`PathReport`), which decides
(`PathFollower`). A frame goes in each slot, so the count of a frame tells when it was sent. A queue
on the path is the smallest delay of an interval above the smallest one of the last 10 to 20 s.
Neither jitter nor a picture that is just passing looks like one.
"""

import struct
from collections import deque
from typing import NamedTuple

from kontur_av.clock import NS_PER_MS, NS_PER_S, NS_PER_US
from telepresence.link.frame import COUNT_MASK

#: A report is sent this often.
REPORT_NS = 100 * NS_PER_MS
#: Counts of a report are of 32 bits.
_MASK = (1 << 32) - 1
_FIELDS = struct.Struct(">5I")
#: A frame that jumps by more slots than this is believed when all others did so for `_ANCHOR_NS`.
_MOST_SLOTS = 1000
_ANCHOR_NS = 200 * NS_PER_MS
_SMALLEST = 3
#: A report that is older than the one before by less than this was overtaken.
_OVERTAKEN_US = 1_000_000


class PathReport(NamedTuple):
    """What arrived at one end since some instant, modulo 2^32.

    time_us: of the report, on the clock of the end that measures. octets: of the records, with UDP
    and IP. expected: records, by their sequence numbers. received: those that came. delay_us: the
    third smallest delay of the last interval, but for an offset.
    """

    time_us: int
    octets: int
    expected: int
    received: int
    delay_us: int

    def pack(self) -> bytes:
        return _FIELDS.pack(*(field & _MASK for field in self))

    @classmethod
    def parse(cls, content: bytes) -> "PathReport | None":
        """Return the report; None: it is malformed."""
        return cls(*_FIELDS.unpack(content)) if len(content) == _FIELDS.size else None

    def since(self, before: "PathReport") -> "PathReport":
        """Return by how much each field grew."""
        return PathReport(*(new - old & _MASK for new, old in zip(self, before, strict=True)))


class Arrivals:
    """Measures the way in. Call `handle_record` for each record, `poll_transmit` once a slot."""

    def __init__(self, slot_ns: int) -> None:
        self._slot_ns = slot_ns
        self._octets = self._expected = self._received = 0
        self._keys = self._newest = -1
        #: The newest frame: its count, and the slots since the first one.
        self._count: int | None = None
        self._slots = self._heard_ns = 0
        #: The three smallest delays of this interval. The third counts: a simulated radio may have
        #: hit the count of a frame, which then seems to be early.
        self._least_ns: list[int] = []
        self._delay_ns = self._due_ns = 0

    def handle_record(
        self, keys: int, sequence: int, count: int | None, octets: int, now_ns: int
    ) -> None:
        """A record came for the first time.

        keys: number of its keys, which grows. sequence: under them. count: of its newest frame;
        None: it has no frame.
        """
        self._octets += octets
        self._received += 1
        if keys != self._keys:
            self._expected += 1
            if keys > self._keys:
                self._keys, self._newest = keys, sequence
        elif sequence > self._newest:
            self._expected += sequence - self._newest
            self._newest = sequence
        if count is not None:
            self._note_delay(count, now_ns)

    def _note_delay(self, count: int, now_ns: int) -> None:
        half = COUNT_MASK + 1 >> 1
        ahead = 1 if self._count is None else (count - self._count + half & COUNT_MASK) - half
        if abs(ahead) > _MOST_SLOTS and now_ns - self._heard_ns < _ANCHOR_NS:
            return
        self._heard_ns = now_ns
        slots = self._slots + ahead
        if ahead > 0 or abs(ahead) > _MOST_SLOTS:
            self._slots, self._count = slots, count
        delay_ns, least = now_ns - slots * self._slot_ns, self._least_ns
        if len(least) < _SMALLEST or delay_ns < least[-1]:
            self._least_ns = sorted((*least, delay_ns))[:_SMALLEST]

    def poll_transmit(self, now_ns: int) -> bytes | None:
        """Return a report for the peer, if one is due."""
        if now_ns < self._due_ns or not self._received:
            return None
        self._due_ns = now_ns + REPORT_NS
        if len(self._least_ns) == _SMALLEST:
            self._delay_ns = self._least_ns[-1]
        self._least_ns = []
        return PathReport(
            now_ns // NS_PER_US,
            self._octets,
            self._expected,
            self._received,
            self._delay_ns // NS_PER_US,
        ).pack()


#: The whole, of which `Allowed.cap_parts` are parts.
PARTS = 1000


class Allowed(NamedTuple):
    """What of the profile goes over the path.

    idle: repair in idle zones, and the lowest level. cap_parts: of the caps of video; 0: video is
    held. leave_out: one picture of so many is to be left out; 0: none.
    """

    state: str = "all"
    idle: bool = True
    cap_parts: int = PARTS
    leave_out: int = 0


ALL = Allowed()
#: The state of a path that is too slow, where nothing that may be left out would save anything.
_TOO_SLOW = ALL._replace(state="too slow")
#: Why it is.
_FIXED = "the path cannot carry the profile: use --path compact"


class PathNeeds(NamedTuple):
    """The videos of the way out: the sum of their caps, and how far these may fall, in parts."""

    video_bps: int = 0
    least_parts: int = PARTS


NO_VIDEO = PathNeeds()
#: Each step of the caps is this share of the one before.
_STEP = 0.85
#: Leave out every second picture, or as many as `least_fps` lets.
_LEAVE_OUT = 2
_RATE_SAVES = 0.3
#: A queue of this length is too long. So is a long one with losses above the usual ones.
_TOO_LONG_NS = 50 * NS_PER_MS
_LOSSES_ABOVE = 0.05
#: While the queue is shorter, more is tried. If the queue gets longer by this, that has failed.
_LONG_NS = 25 * NS_PER_MS
#: A step down shows at the other end after this time.
_SETTLES_NS = 300 * NS_PER_MS
#: A queue that gets shorter by this between two reports drains.
_DRAINS_NS = 5 * NS_PER_MS
#: A little more is tried after this time, and watched for as long.
_TRY_NS = NS_PER_S
#: A try makes records wait, and with HEVC costs two key pictures. If it failed, the next one comes
#: after this share of the time for which the path has been slow: at least twice `_TRY_NS`, and at
#: most this.
_AGAIN_SHARE, _MOST_AGAIN_NS = 8, 30 * NS_PER_S
#: When the first step passes, so many follow at once, after this time each.
_NEXT, _NEXT_NS = 3, 400 * NS_PER_MS
#: A better state is told to people when it has lasted this long.
_LASTS_NS = 5 * NS_PER_S
#: The smallest delay is looked for in this window and the one before.
_WINDOW_NS = 10 * NS_PER_S
#: Loss is of as many reports, rates are of three.
_KEPT = 6


class PathFollower:
    """Decides what goes over the path, from the other end's reports.

    allowed: what goes now. why: of it, in one line.
    path_bps, queue_ns, loss: what arrives at the other end, how long it waits on the path, and the
    share of records that is lost.
    """

    def __init__(self, needs: PathNeeds) -> None:
        self.needs = needs
        self.allowed, self._why = ALL, ""
        self.path_bps = self.queue_ns = 0
        self.loss = self._usual = 0.0
        self._fixed = [ALL, _TOO_SLOW]
        self._compact, self._saved_bps = _levels(needs)
        self._levels, self._level = self._fixed, 0
        #: When each report came, what had been sent by then, and the report.
        self._kept: deque[tuple[int, int, PathReport]] = deque(maxlen=_KEPT)
        self._offset_us: int | None = None
        self._window_ns = 0
        self._least_us = self._least_before_us = 1 << 31
        self._told, self._told_level, self._state_ns = ALL.state, 0, 0
        #: Since when not all goes.
        self._slow_ns = 0
        self._raise_ns, self._lowered_ns = 0, -NS_PER_S
        #: The level and the queue before the newest step up, and when that was; below 0: none since
        #: the last step down.
        self._tried = self._tried_ns = 0
        self._raised_ns = -_TRY_NS

    @property
    def why(self) -> str:
        return self._why if self._level else ""

    def handle_report(
        self, report: PathReport, octets_sent: int, now_ns: int, *, compact: bool
    ) -> str | None:
        """A report came. Return in words a state that people are to be told of, or None.

        octets_sent: of all records, with UDP and IP. compact: idle octets are left out.
        """
        before = self.allowed.state
        self._take(report, octets_sent, now_ns, compact)
        state = self.allowed.state
        if state != before:
            self._state_ns = now_ns
        # Tries are not told, nor their failures.
        lasts = now_ns - self._state_ns >= _LASTS_NS
        lower = self._level > self._told_level
        if state == self._told or not (lower or lasts):
            return None
        self._told, self._told_level = state, self._level
        return f"{state}, because {self.why}" if lower else state

    def _take(self, report: PathReport, octets_sent: int, now_ns: int, compact: bool) -> None:
        kept = self._kept
        if kept:
            later_us = report.time_us - kept[-1][2].time_us & _MASK
            if later_us == 0 or _MASK - later_us < _OVERTAKEN_US:
                return
            if later_us > _OVERTAKEN_US:
                # The other end began anew, or was not heard.
                kept.clear()
                self._offset_us = None
        kept.append((now_ns, octets_sent, report))
        if len(kept) < 3:
            return
        self._use(compact)
        few, all_kept = report.since(kept[-3][2]), report.since(kept[0][2])
        self.path_bps = few.octets * 8_000_000 // few.time_us
        lost = (all_kept.expected - all_kept.received + (1 << 31) & _MASK) - (1 << 31)
        self.loss = max(0, lost) / max(1, all_kept.expected)
        if report.since(kept[-2][2]).received >= _SMALLEST:
            self._decide(report, now_ns)

    def _decide(self, report: PathReport, now_ns: int) -> None:
        losing = self.loss > self._usual + _LOSSES_ABOVE
        before_ns = self.queue_ns
        self.queue_ns = queue_ns = self._queue_us(report.delay_us, losing, now_ns) * NS_PER_US
        if now_ns - self._raised_ns < _TRY_NS and queue_ns >= self._tried_ns + _LONG_NS:
            again_ns = (now_ns - self._slow_ns) // _AGAIN_SHARE
            self._go(self._tried, now_ns, min(max(again_ns, 2 * _TRY_NS), _MOST_AGAIN_NS))
        elif queue_ns >= (_LONG_NS if losing else _TOO_LONG_NS):
            if queue_ns > before_ns - _DRAINS_NS and now_ns - self._lowered_ns >= _SETTLES_NS:
                self._lower(now_ns)
            return
        if not (losing and self._level and self._levels is self._fixed):
            self._usual += (self.loss - self._usual) / 16
        if self._level and queue_ns < _LONG_NS and not losing and now_ns >= self._raise_ns:
            self._raise(now_ns)

    def _queue_us(self, delay_us: int, losing: bool, now_ns: int) -> int:
        """How long records wait on the path."""
        if self._offset_us is None:
            self._offset_us = delay_us
            self._least_us = self._least_before_us = 1 << 31
            self._window_ns = now_ns
        relative_us = (delay_us - self._offset_us + (1 << 31) & _MASK) - (1 << 31)
        # What is lost in a full queue tells that its delay is no new smallest one.
        if now_ns - self._window_ns >= _WINDOW_NS and not losing:
            self._least_before_us, self._least_us = self._least_us, relative_us
            self._window_ns = now_ns
        self._least_us = min(self._least_us, relative_us)
        return relative_us - min(self._least_us, self._least_before_us)

    def _lower(self, now_ns: int) -> None:
        """Leave out as much as does not pass, and what drains the queue within about a second."""
        last, saved_bps = len(self._levels) - 1, self._saved_bps
        before, newest = self._kept[-3], self._kept[-1]
        sent_bps = (newest[1] - before[1]) * 8 * NS_PER_S // max(1, newest[0] - before[0])
        again = now_ns - self._lowered_ns < NS_PER_S
        if again and sent_bps < 0.95 * self.path_bps:
            # The last step suffices, and the queue is about to drain.
            return
        aim_bps = self.path_bps * max(0.5, 0.95 - self.queue_ns / NS_PER_S)
        level = self._level + 1
        if level == 1 and self._usual < 0.001:
            # Idle zones carry repair only where there are losses.
            level = 2
        # If the last step did not suffice, pictures may be smaller than their caps.
        level += again
        if level > 1:
            wanted_bps = saved_bps[min(self._level, last)] + sent_bps - aim_bps
            while level < last and saved_bps[level] < wanted_bps:
                level += 1
        if not self._level:
            self._slow_ns = now_ns
        self._go(min(level, last), now_ns, _TRY_NS)
        waits = f"records wait {self.queue_ns // NS_PER_MS} ms, and"
        why = f"{waits} {self.path_bps // 1000} kbit/s of {sent_bps // 1000} arrive"
        self._why = _FIXED if self._levels is self._fixed else why

    def _go(self, level: int, now_ns: int, try_ns: int) -> None:
        """Down to this level. More is tried after `try_ns`."""
        self._raised_ns = -_TRY_NS
        self._lowered_ns, self._raise_ns = now_ns, now_ns + try_ns
        self._level, self.allowed = level, self._levels[level]

    def _raise(self, now_ns: int) -> None:
        """Let more go: at first a little, which may not pass."""
        step, wait_ns = (1, _TRY_NS) if self._raised_ns < 0 else (_NEXT, _NEXT_NS)
        self._tried, self._tried_ns, self._raised_ns = self._level, self.queue_ns, now_ns
        self._level, self._raise_ns = max(0, self._level - step), now_ns + wait_ns
        self.allowed = self._levels[self._level]

    def _use(self, compact: bool) -> None:
        levels = self._compact if compact else self._fixed
        if levels is not self._levels:
            self._levels, self._level, self._raised_ns = levels, 0, -_TRY_NS
            self.allowed = ALL


def _levels(needs: PathNeeds) -> tuple[list[Allowed], list[int]]:
    """Return what goes, from all to the least, and what each level saves of the videos' rate."""
    levels, parts = [ALL, ALL._replace(state="no idle", idle=False)], float(PARTS)
    if not needs.video_bps:
        return levels, [0, 0]
    while levels[-1].cap_parts > needs.least_parts:
        parts = max(parts * _STEP, needs.least_parts)
        levels.append(Allowed("lower caps", False, int(parts)))
    saved_bps = [needs.video_bps * (PARTS - level.cap_parts) // PARTS for level in levels]
    least = levels[-1].cap_parts
    levels.append(Allowed("fewer pictures", False, least, _LEAVE_OUT))
    saved_bps.append(int(saved_bps[-1] + _RATE_SAVES * needs.video_bps * least / PARTS))
    levels.append(Allowed("no video", False, 0, _LEAVE_OUT))
    return levels, [*saved_bps, needs.video_bps]
