"""What a media stream and a direction of samples took, from their origin to their display. Cores.

All stamps of a session are of one clock, so a latency is a difference of two. The RTP timestamp
joins the two ends of a stream, the sequence number those of the haptics.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import OrderedDict, deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.meters import Histogram, RateMeter, rank_of
from kontur_av.streams.lipsync import EARLIEST_NS, LATEST_NS
from pipelines.report.model import LipSyncReport, SkewReport
from pipelines.report.terms import LONGEST_GAP_NS, DelaySums
from pipelines.session.session_metrics import OutRow, Row, ShownRow
from telepresence.haptics.latency import LatencyMatcher

#: This many latencies of a sense are remembered, to be compared with those of another one: 20 s of
#: 50 a second. The messages of all senses about an instant come within seconds.
RECENT_DEPTH = 1024


class Recent:
    """The recent latencies (ns) of a sense, by the instant at which it was perceived."""

    def __init__(self) -> None:
        self._instants_ns: deque[int] = deque(maxlen=RECENT_DEPTH)
        self._latencies_ns: deque[int] = deque(maxlen=RECENT_DEPTH)

    def add(self, instant_ns: int, latency_ns: int) -> None:
        self._instants_ns.append(instant_ns)
        self._latencies_ns.append(latency_ns)

    def at(self, instant_ns: int) -> int | None:
        """The latency of what was perceived at `instant_ns`; None if that is unknown."""
        index = bisect_right(self._instants_ns, instant_ns) - 1
        if index < 0 or instant_ns - self._instants_ns[index] > NS_PER_S // 2:
            return None
        return self._latencies_ns[index]


class Skew:
    """How much later one sense comes than another (ns), signed: positive if the first is late."""

    def __init__(self) -> None:
        self._later = Histogram()
        self._earlier = Histogram()

    def add(self, skew_ns: int) -> None:
        (self._later if skew_ns >= 0 else self._earlier).add(abs(skew_ns))

    def summary_ms(self) -> SkewReport:
        """p50, p95, p99 and max of the signed skew; max is the farthest from zero."""
        farthest = self._later.max
        if self._earlier.max > farthest:
            farthest = -self._earlier.max
        p50, p95, p99 = (self._percentile(p) / 1e6 for p in (50, 95, 99))
        return SkewReport(p50=p50, p95=p95, p99=p99, max=farthest / 1e6, count=self.count)

    @property
    def count(self) -> int:
        return self._later.count + self._earlier.count

    def _percentile(self, p: float) -> float:
        if not self.count:
            return 0.0
        rank, earlier = rank_of(p, self.count), self._earlier.count
        if rank <= earlier:
            return -self._earlier.ranked(earlier + 1 - rank)
        return self._later.ranked(rank - earlier)


class LipSyncShare:
    """The share of the time in which sound and picture were in sync after ITU-R BT.1359.

    Each picture counts for as long as it is shown, at most half a second.
    """

    def __init__(self) -> None:
        self._within_ns = self._early_ns = self._late_ns = 0
        self._last: tuple[int, int] | None = None

    def add(self, displayed_ns: int, skew_ns: int) -> None:
        """A picture was displayed, and the sound at that instant was later by `skew_ns`."""
        if self._last is not None:
            before_ns, skew_before_ns = self._last
            shown_ns = min(max(0, displayed_ns - before_ns), NS_PER_S // 2)
            if skew_before_ns < -EARLIEST_NS:
                self._early_ns += shown_ns
            elif skew_before_ns > LATEST_NS:
                self._late_ns += shown_ns
            else:
                self._within_ns += shown_ns
        self._last = displayed_ns, skew_ns

    def summary(self) -> LipSyncReport:
        """Shares of the time, from 0 to 1: in sync, sound too early, sound too late."""
        total_ns = max(1, self._within_ns + self._early_ns + self._late_ns)
        return LipSyncReport(
            within=round(self._within_ns / total_ns, 6),
            early=round(self._early_ns / total_ns, 6),
            late=round(self._late_ns / total_ns, 6),
        )

    @property
    def counted_ns(self) -> int:
        """The duration (ns) of all counted pictures."""
        return self._within_ns + self._early_ns + self._late_ns


#: How long an access unit waits for the report of its other end.
_JOIN_NS = 10 * NS_PER_S
_JOIN_DEPTH = 2000
#: Of a thousand haptic samples a second, one of these is enough to compare other senses with.
_FELT_EVERY_NS = 20 * NS_PER_MS
#: Shorter gaps are no pauses.
_SHOWN_PAUSE_NS = NS_PER_S
_FELT_PAUSE_NS = NS_PER_S // 5
#: Half a minute, because a process reports twice a second.
_LATELY_BATCHES = 60
#: Half a turn of the samples' sequence numbers at 1 kHz: beyond that a match would be a guess.
_TURN_NS = 30 * NS_PER_S

STAGES = ("capture_to_encoded", "encoded_to_sent", "sent_to_received", "received_to_displayed")

#: At most this many pauses are remembered.
_PAUSES_DEPTH = 1000


class Pauses:
    """The pauses of a display or of a haptic channel, each longer than `least_ns`."""

    def __init__(self, least_ns: int) -> None:
        self.least_ns = least_ns
        #: Ended pauses: the instants before and after. Beyond 1000 the oldest are dropped.
        self.ended_ns: deque[tuple[int, int]] = deque(maxlen=_PAUSES_DEPTH)
        self.first_ns: int | None = None
        self.last_ns: int | None = None

    def add(self, instant_ns: int) -> None:
        if self.last_ns is None:
            self.first_ns = instant_ns
        elif instant_ns - self.last_ns > self.least_ns:
            self.ended_ns.append((self.last_ns, instant_ns))
        self.last_ns = instant_ns

    def add_all(self, instants_ns: NDArray[np.int64]) -> None:
        """Something was shown or felt at each of these instants, shape (n,), n > 0."""
        self.add(int(instants_ns[0]))
        for index in np.flatnonzero(np.diff(instants_ns) > self.least_ns).tolist():
            self.ended_ns.append((int(instants_ns[index]), int(instants_ns[index + 1])))
        self.last_ns = int(instants_ns[-1])

    def within(self, begin_ns: int, end_ns: int) -> list[tuple[int, int]]:
        """The pauses of a session, with those before the first instant and after the last one."""
        if self.first_ns is None or self.last_ns is None:
            every = [(begin_ns, end_ns)]
        else:
            every = [(begin_ns, self.first_ns), *self.ended_ns, (self.last_ns, end_ns)]
        return [pause for pause in every if pause[1] - pause[0] > self.least_ns]

    def within_s(self, begin_ns: int, end_ns: int) -> list[tuple[float, float]]:
        """The same in seconds of the session."""
        return [
            (round((first - begin_ns) / NS_PER_S, 3), round((last - begin_ns) / NS_PER_S, 3))
            for first, last in self.within(begin_ns, end_ns)
        ]


@dataclass(slots=True)
class _Journey:
    """What is known so far of one access unit or block of sound, in the columns of its rows."""

    seen_ns: int
    capture_ns: int | None = None
    encoded_ns: int = 0
    sent_ns: int = 0
    received_ns: int | None = None
    displayed_ns: int | None = None
    #: Of pictures: at the encoder, encoding begun, decoded; the capture of the one before it that
    #: was displayed lies `gap_ns` back.
    came_ns: int = 0
    begun_ns: int | None = None
    decoded_ns: int | None = None
    gap_ns: int = 0
    octets: int = 0
    packets: int = 0


class StreamMetrics:
    """One media stream, from capture to display."""

    def __init__(self) -> None:
        self.rate = RateMeter()
        #: Whether the stamps of what is displayed are known in the display's clock.
        self.dated = True
        #: How far they may be wrong: the error between the clocks of two machines.
        self.error_ns = 0
        #: The largest excess of the rate over a sliding second above the cap at its end; that rate.
        self.above_cap_bps = 0.0, 0.0
        self.latency = Histogram()
        self.stages = {stage: Histogram() for stage in STAGES}
        self.recent = Recent()
        self.last_latency_ns: int | None = None
        #: Displayed instants and latencies that were not compared with the other senses yet.
        self.fresh: deque[tuple[int, int]] = deque(maxlen=RECENT_DEPTH)
        #: From when to when nothing was displayed.
        self.pauses = Pauses(_SHOWN_PAUSE_NS)
        #: Difference of the capture time that travelled by RTCP from the stamp itself.
        self.stamp_error = Histogram()
        #: Of pictures: the terms of their latency.
        self.way = DelaySums()
        self._captured_ns: int | None = None
        self._journeys: OrderedDict[int, _Journey] = OrderedDict()

    def handle_rows(self, kind: type[Row], rows: NDArray[np.int64], now_ns: int) -> None:
        """Rows of one `kind`, shape (n, columns), from its sender, receiver or display."""
        if kind is OutRow:
            self.handle_out(rows)
        elif kind is ShownRow:
            self.handle_shown(rows, now_ns)
        else:
            for timestamp, *values in rows.tolist():
                journey = self._journey(timestamp, now_ns)
                for name, value in zip(kind._fields[1:], values, strict=True):
                    setattr(journey, name, value)
                self._finish(timestamp, journey)

    def handle_out(self, rows: NDArray[np.int64]) -> None:
        for instant_ns, octets, cap_bps in rows.tolist():
            # A restarted sender's first report may overtake its predecessor's last.
            last_ns = self.rate.last_ns
            at_ns = instant_ns if last_ns is None else max(instant_ns, last_ns)
            self.rate.add(at_ns, octets)
            bps = self.rate.last_bps(at_ns)
            if bps - cap_bps > self.above_cap_bps[0]:
                self.above_cap_bps = bps - cap_bps, bps

    def handle_shown(self, rows: NDArray[np.int64], now_ns: int) -> None:
        for timestamp, capture_ns, displayed_ns in rows.tolist():
            self.pauses.add(displayed_ns)
            if not self.dated:
                continue
            latency_ns = displayed_ns - capture_ns
            self.latency.add(latency_ns)
            self.last_latency_ns = latency_ns
            self.recent.add(displayed_ns, latency_ns)
            self.fresh.append((displayed_ns, latency_ns))
            journey = self._journey(timestamp, now_ns)
            journey.displayed_ns = displayed_ns
            if self._captured_ns is not None:
                journey.gap_ns = capture_ns - self._captured_ns
            self._captured_ns = capture_ns
            if journey.capture_ns is not None:
                self.stamp_error.add(abs(journey.capture_ns - capture_ns))
            self._finish(timestamp, journey)

    def _journey(self, timestamp: int, now_ns: int) -> _Journey:
        journey = self._journeys.get(timestamp)
        if journey is None:
            journey = self._journeys[timestamp] = _Journey(now_ns)
            while len(self._journeys) > _JOIN_DEPTH or (
                now_ns - next(iter(self._journeys.values())).seen_ns > _JOIN_NS
            ):
                self._journeys.popitem(last=False)
        return journey

    def _finish(self, timestamp: int, journey: _Journey) -> None:
        if journey.capture_ns is None or journey.received_ns is None:
            return
        if journey.displayed_ns is None:
            return
        instants = (
            journey.capture_ns,
            journey.encoded_ns,
            journey.sent_ns,
            journey.received_ns,
            journey.displayed_ns,
        )
        for stage, begin_ns, end_ns in zip(STAGES, instants, instants[1:], strict=False):
            self.stages[stage].add(end_ns - begin_ns)
        if journey.begun_ns is not None and 0 < journey.gap_ns <= LONGEST_GAP_NS:
            captured, encoded, _, received, displayed = instants
            decoded = displayed if journey.decoded_ns is None else journey.decoded_ns
            way = captured, journey.came_ns, journey.begun_ns, encoded, received, decoded
            self.way.add((*way, displayed), journey.gap_ns, (journey.octets, journey.packets))
        del self._journeys[timestamp]

    def negative(self) -> dict[str, int]:
        """The number of latencies below 0, by stage. Each means a wrong stamp."""
        every = {"capture_to_displayed": self.latency, **self.stages}
        return {name: histogram.negative for name, histogram in every.items() if histogram.negative}


class HapticMetrics:
    """One direction of the haptic samples, of so many octets each."""

    def __init__(self, sample_octets: int) -> None:
        self._octets = sample_octets
        self.rate = RateMeter(windows_ns=(NS_PER_S,))
        self.latency = Histogram()
        self.recent = Recent()
        #: From when to when no sample was received.
        self.pauses = Pauses(_FELT_PAUSE_NS)
        self._matcher = LatencyMatcher()
        #: The newest batches of (sequence, instant) of what was received.
        self._lately: deque[NDArray[np.int64]] = deque(maxlen=_LATELY_BATCHES)

    @property
    def unmatched(self) -> int:
        """Samples received whose instant of sending never became known."""
        return self._matcher.unmatched

    def handle_sent(self, rows: NDArray[np.int64], now_ns: int) -> None:
        self._matcher.handle_sent(rows)
        self._match(now_ns)

    def handle_received(self, rows: NDArray[np.int64], now_ns: int) -> None:
        if not len(rows):
            return
        self._lately.append(rows.copy())
        self._matcher.handle_received(rows)
        self.pauses.add_all(rows[:, 1])
        _, first, counts = np.unique(
            rows[:, 1] // _FELT_EVERY_NS, return_index=True, return_counts=True
        )
        for instant_ns, samples in zip(rows[first, 1].tolist(), counts.tolist(), strict=True):
            last_ns = self.rate.last_ns
            # A restarted end's first report may overtake its predecessor's last.
            at_ns = instant_ns if last_ns is None else max(instant_ns, last_ns)
            self.rate.add(at_ns, samples * self._octets)
        self._match(now_ns)

    def sent_ns_at(self, instant_ns: int) -> int | None:
        """When the newest sample at `instant_ns` was sent; None if that is unknown."""
        for rows in reversed(self._lately):
            if rows[0, 1] <= instant_ns:
                index = int(np.searchsorted(rows[:, 1], instant_ns, "right")) - 1
                sent_ns = self._matcher.sent_ns(int(rows[index, 0]))
                known = sent_ns is not None and abs(instant_ns - sent_ns) < _TURN_NS
                return sent_ns if known else None
        return None

    def _match(self, now_ns: int) -> None:
        """Take the latency of each sample whose two stamps have come."""
        matches = self._matcher.take_matches_ns(now_ns)
        if not len(matches):
            return
        self.latency.add(matches[:, 1])
        _, first = np.unique(matches[:, 0] // _FELT_EVERY_NS, return_index=True)
        for instant_ns, latency_ns in matches[first].tolist():
            self.recent.add(instant_ns, latency_ns)
