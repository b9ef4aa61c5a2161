"""Puts together what the processes of a session tell: the one source of its report.

A core: it is told the time. Stamps of one session are of one clock, so a latency is a difference;
the two ends of a stream are joined by the RTP timestamp, those of the haptics by their sequence.
"""

from __future__ import annotations

from array import array
from bisect import bisect_right
from collections import OrderedDict, deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kontur_av.clock import NS_PER_S
from kontur_av.meters import Histogram, RateMeter
from pipelines.probe import Message
from telepresence.haptics.latency import LatencyMatcher

#: How long an access unit waits for what its other end has to say about it.
_JOIN_NS = 10 * NS_PER_S
_JOIN_DEPTH = 2000
#: Latencies are remembered this long to be compared with those of another sense.
_RECENT_DEPTH = 8192

STAGES = ("capture_to_encoded", "encoded_to_sent", "sent_to_received", "received_to_displayed")

#: Series of rows and their widths.
_WIDTHS = {"out": 2, "tx": 4, "rx": 2, "shown": 3, "haptic_tx": 2, "haptic_rx": 2, "lateness": 1}


class Recent:
    """The latencies (ns) of a sense over the last while, by the instant at which it came."""

    def __init__(self) -> None:
        self._instants_ns: deque[int] = deque(maxlen=_RECENT_DEPTH)
        self._latencies_ns: deque[int] = deque(maxlen=_RECENT_DEPTH)

    def add(self, instant_ns: int, latency_ns: int) -> None:
        self._instants_ns.append(instant_ns)
        self._latencies_ns.append(latency_ns)

    def at(self, instant_ns: int) -> int | None:
        """The latency of what was felt (seen, heard) at `instant_ns`; None if that is unknown."""
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

    def summary_ms(self) -> dict[str, float]:
        """p50, p95 and max of the signed skew; max is the one farthest from zero."""
        farthest = self._later.max
        if self._earlier.max > farthest:
            farthest = -self._earlier.max
        return {
            "p50": self._percentile(50) / 1e6,
            "p95": self._percentile(95) / 1e6,
            "max": farthest / 1e6,
        }

    @property
    def count(self) -> int:
        return self._later.count + self._earlier.count

    def _percentile(self, p: float) -> float:
        if not self.count:
            return 0.0
        below = 100 * self._earlier.count / self.count
        if p <= below:
            return -self._earlier.percentile(100 * (below - p) / below if below else 0)
        return self._later.percentile(100 * (p - below) / (100 - below))


@dataclass(slots=True)
class _Journey:
    """What is known so far of one access unit or block of sound."""

    seen_ns: int
    capture_ns: int | None = None
    encoded_ns: int = 0
    sent_ns: int = 0
    received_ns: int | None = None
    displayed_ns: int | None = None


class StreamFigures:
    """One media stream, from capture to display."""

    def __init__(self) -> None:
        self.rate = RateMeter()
        self.latency = Histogram()
        self.stages = {stage: Histogram() for stage in STAGES}
        self.recent = Recent()
        self.last_latency_ns: int | None = None
        #: Displayed instants and latencies that were not compared with the other senses yet.
        self.fresh: deque[tuple[int, int]] = deque(maxlen=_RECENT_DEPTH)
        #: How far the capture time that travelled by RTCP lies beside the one that was stamped.
        self.stamp_error = Histogram()
        self._journeys: OrderedDict[int, _Journey] = OrderedDict()

    def handle_out(self, rows: NDArray[np.int64]) -> None:
        for instant_ns, octets in rows.tolist():
            # A restarted sender's first report may overtake its predecessor's last.
            last_ns = self.rate.last_ns
            self.rate.add(instant_ns if last_ns is None else max(instant_ns, last_ns), octets)

    def handle_tx(self, rows: NDArray[np.int64], now_ns: int) -> None:
        for timestamp, capture_ns, encoded_ns, sent_ns in rows.tolist():
            journey = self._journey(timestamp, now_ns)
            journey.capture_ns, journey.encoded_ns = capture_ns, encoded_ns
            journey.sent_ns = sent_ns
            self._finish(timestamp, journey)

    def handle_rx(self, rows: NDArray[np.int64], now_ns: int) -> None:
        for timestamp, received_ns in rows.tolist():
            journey = self._journey(timestamp, now_ns)
            journey.received_ns = received_ns
            self._finish(timestamp, journey)

    def handle_shown(self, rows: NDArray[np.int64], now_ns: int) -> None:
        for timestamp, capture_ns, displayed_ns in rows.tolist():
            latency_ns = displayed_ns - capture_ns
            self.latency.add(latency_ns)
            self.last_latency_ns = latency_ns
            self.recent.add(displayed_ns, latency_ns)
            self.fresh.append((displayed_ns, latency_ns))
            journey = self._journey(timestamp, now_ns)
            journey.displayed_ns = displayed_ns
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
        del self._journeys[timestamp]


class HapticFigures:
    """One direction of the haptic samples."""

    def __init__(self) -> None:
        self.latency = Histogram()
        self.recent = Recent()
        self._matcher = LatencyMatcher()

    def handle_sent(self, rows: NDArray[np.int64]) -> None:
        self._matcher.handle_sent(tuple(row) for row in rows.tolist())

    def handle_received(self, rows: NDArray[np.int64], now_ns: int) -> None:
        self._matcher.handle_received([tuple(row) for row in rows.tolist()])
        self.match(now_ns)
        if len(rows) and self.latency.count:
            # One value a batch (half a second) is enough to compare other senses with.
            self.recent.add(int(rows[-1, 1]), self._last_ns)

    def match(self, now_ns: int) -> None:
        latencies = self._matcher.take_latencies_ns(now_ns)
        if latencies:
            self.latency.add(np.array(latencies))
            self._last_ns = sorted(latencies)[len(latencies) // 2]

    _last_ns = 0


@dataclass
class ProcessFigures:
    """What one process of the session has told, over all its lives."""

    totals: dict[str, int] = field(default_factory=dict)
    gauges: dict[str, Any] = field(default_factory=dict)
    lateness: Histogram = field(default_factory=Histogram)
    #: Snapshots of nested counters (`link`) of the lives that have ended.
    ended_links: list[dict[str, Any]] = field(default_factory=list)
    _ended_totals: dict[str, int] = field(default_factory=dict)

    def total(self, name: str) -> int:
        """A counter, over all lives."""
        return self._ended_totals.get(name, 0) + self.totals.get(name, 0)

    def names(self) -> list[str]:
        return sorted({*self._ended_totals, *self.totals})

    def handle_end(self) -> None:
        """The process has ended: what it counted is kept, the next one begins at 0."""
        for name, value in self.totals.items():
            self._ended_totals[name] = self._ended_totals.get(name, 0) + value
        self.totals = {}
        if "link" in self.gauges:
            self.ended_links.append(self.gauges.pop("link"))

    def links(self) -> Iterator[dict[str, Any]]:
        """The link's counters of each life."""
        yield from self.ended_links
        if "link" in self.gauges:
            yield self.gauges["link"]


#: Which process sends the samples of a haptic direction, and which receives them.
HAPTIC_ENDS = {"up": ("robot", "joystick"), "down": ("joystick", "robot")}


class Collector:
    """Takes every process' messages. `streams` are the names of the setup's media streams."""

    def __init__(self, streams: list[str]) -> None:
        self.streams = {name: StreamFigures() for name in streams}
        self.haptics = {name: HapticFigures() for name in HAPTIC_ENDS}
        self.processes: dict[str, ProcessFigures] = {}
        self.skews = {name: Skew() for name in ("video_haptic", "audio_haptic", "audio_video")}

    def process(self, name: str) -> ProcessFigures:
        """The figures of the process `name`."""
        figures = self.processes.get(name)
        if figures is None:
            figures = self.processes[name] = ProcessFigures()
        return figures

    def handle_message(self, process: str, message: Message, now_ns: int) -> None:
        """A process has told something."""
        figures = self.process(process)
        figures.totals.update(message.totals)
        figures.gauges.update(message.gauges)
        for series, values in message.series.items():
            self._handle_series(process, figures, series, values, now_ns)
        # By then the other senses' messages about that instant have come.
        self._compare(now_ns - NS_PER_S)

    def handle_end(self) -> None:
        """The session is over: compare what still waits."""
        self._compare(None)

    def _handle_series(
        self, process: str, figures: ProcessFigures, series: str, values: array[int], now_ns: int
    ) -> None:
        kind, _, stream = series.partition(".")
        rows = np.frombuffer(values, np.int64).reshape(-1, _WIDTHS[kind])
        if kind == "lateness":
            figures.lateness.add(rows)
        elif kind in ("haptic_tx", "haptic_rx"):
            for name, (sender, receiver) in HAPTIC_ENDS.items():
                if kind == "haptic_tx" and process == sender:
                    self.haptics[name].handle_sent(rows)
                elif kind == "haptic_rx" and process == receiver:
                    self.haptics[name].handle_received(rows, now_ns)
        elif kind == "shown":
            self.streams[stream].handle_shown(rows, now_ns)
        else:
            name = process.removesuffix("_send").removesuffix("_receive")
            if kind == "out":
                self.streams[name].handle_out(rows)
            elif kind == "tx":
                self.streams[name].handle_tx(rows, now_ns)
            else:
                self.streams[name].handle_rx(rows, now_ns)

    def _compare(self, until_ns: int | None) -> None:
        """The skews at the operator in space: who sees, hears and feels the ground."""
        force = self.haptics["up"].recent
        video, audio = self.streams.get("uplink_video"), self.streams.get("uplink_voice")
        for figures, name in ((video, "video_haptic"), (audio, "audio_haptic")):
            if figures is None:
                continue
            while figures.fresh and (until_ns is None or figures.fresh[0][0] <= until_ns):
                displayed_ns, latency_ns = figures.fresh.popleft()
                felt_ns = force.at(displayed_ns)
                if felt_ns is not None:
                    self.skews[name].add(latency_ns - felt_ns)
                if figures is video and audio is not None:
                    heard_ns = audio.recent.at(displayed_ns)
                    if heard_ns is not None:
                        self.skews["audio_video"].add(heard_ns - latency_ns)
