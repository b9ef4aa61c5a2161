"""Joins what the processes of a session report; the only source of its report. A core."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.meters import Histogram
from kontur_av.metrics import counts, newest, over, plus
from kontur_av.rtp.receiver import ReceiverCounts
from kontur_av.streams.staleness import State
from kontur_av.streams.video_receiver import VideoReceiverCounts
from kontur_av.streams.voice_receiver import VoiceReceiverCounts
from pipelines.media.media_metrics import CaptureMetrics, DisplayMetrics, SelectorMetrics
from pipelines.report.journeys import HapticMetrics, LipSyncShare, Skew, StreamMetrics
from pipelines.report.sync_metrics import PERCEIVED, SyncMetrics
from pipelines.report.trace import Trace
from pipelines.session.probe import FLUSH_NS, Message, Series
from pipelines.session.session_metrics import (
    ClickRow,
    ClockRow,
    LatenessRow,
    LightRow,
    SampleReceivedRow,
    SampleSentRow,
    SendingRow,
    ShownRow,
)
from pipelines.session.setup.segments import Segment
from pipelines.session.topology.table import Topology
from pipelines.session.topology.topics import RTC_CAMERA, RTC_DISPLAY, RTC_VOICE, SECOND_ROBOT
from telepresence.link.clock_estimator import ClockHistory
from telepresence.link.link_metrics import GatewayMetrics

#: An input reports twice a second. It has paused if its captures lie this far apart.
_PAUSE_NS = 3 * FLUSH_NS

RecordT = TypeVar("RecordT")


@dataclass
class ProcessMetrics:
    """What one process of the session reported, over all its starts."""

    #: `fifo` with real-time priority, else `other`.
    scheduler: str | None = None
    #: Why its newest start that failed ended.
    last_error: str | None = None
    lateness: Histogram = field(default_factory=Histogram)
    #: From a slot's deadline to the instant at which its frame had been sent; of a gateway.
    sending: Histogram = field(default_factory=Histogram)
    #: The link's counters of the starts that have ended.
    ended_links: list[GatewayMetrics] = field(default_factory=list)
    #: Its first and its last report.
    began_ns: int | None = None
    told_ns: int = 0
    #: When the present camera was selected; of the selector.
    selected_ns: int = 0
    #: When the last pause in its captures ended; of an input.
    gives_since_ns: int = 0
    #: When it was started again after a stop that was asked for.
    _resumed_ns: int = 0
    #: By kind and stream: the records of this start, and of the starts before.
    _told: dict[tuple[type, str], object] = field(default_factory=dict)
    _ended: dict[tuple[type, str], object] = field(default_factory=dict)

    def handle_message(self, message: Message, now_ns: int) -> None:
        self.told_ns = now_ns
        if self.began_ns is None:
            self.began_ns = now_ns
        captured_ns, selected = self.capture.captured_ns, self.selected
        self.scheduler = message.scheduler or self.scheduler
        self.last_error = message.last_error or self.last_error
        for key, record in message.metrics.items():
            earlier = self._told.get(key)
            self._told[key] = record if earlier is None else over(record, earlier)
        if self.selected != selected:
            self.selected_ns = now_ns
        newest_ns = self.capture.captured_ns
        if newest_ns is not None and (captured_ns is None or newest_ns - captured_ns > _PAUSE_NS):
            self.gives_since_ns = newest_ns

    def find(self, kind: type[RecordT], stream: str = "") -> RecordT | None:
        """The record of one kind, over all starts; None if no life told any."""
        ended, told = self._ended.get((kind, stream)), self._told.get((kind, stream))
        found = told if ended is None else ended if told is None else plus(ended, told)
        assert found is None or isinstance(found, kind)
        return found

    def total(self, kind: type[RecordT], stream: str = "") -> RecordT:
        """The record of one kind, over all starts; all 0 if no life told any."""
        return self.find(kind, stream) or kind()

    def counts_by_name(self) -> dict[str, int]:
        """What adds up, over all starts, by name, with the name of its stream in front."""
        found = {
            about + name: count
            for about, record in self._records()
            for name, count in counts(record).items()
        }
        return dict(sorted(found.items()))

    def newest_by_name(self) -> dict[str, int | float | str | bool]:
        """All other values that are known, in the same way."""
        return {
            about + name: value
            for about, record in self._records()
            for name, value in newest(record).items()
        }

    def _records(self) -> list[tuple[str, object]]:
        keys = sorted({**self._ended, **self._told}, key=lambda key: key[1])
        return [(f"{key[1]}." if key[1] else "", self.total(*key)) for key in keys]

    @property
    def capture(self) -> CaptureMetrics:
        return self.total(CaptureMetrics)

    @property
    def selected(self) -> str | None:
        return self.total(SelectorMetrics).selected

    @property
    def link(self) -> GatewayMetrics | None:
        """The link, as this start of a gateway reported it."""
        found = self._told.get((GatewayMetrics, ""))
        assert found is None or isinstance(found, GatewayMetrics)
        return found

    @property
    def newest_link(self) -> GatewayMetrics | None:
        """The link, as the newest start of a gateway that told something reported it."""
        return self.link or (self.ended_links[-1] if self.ended_links else None)

    def silent_ns(self, now_ns: int | None = None) -> int:
        """How long an input has captured nothing by `now_ns`, or by its last report."""
        captured_ns = self.capture.captured_ns
        since_ns = self.began_ns if captured_ns is None else captured_ns
        if since_ns is None:
            return 0
        until_ns = self.told_ns if now_ns is None else now_ns
        return max(0, until_ns - max(since_ns, self._resumed_ns))

    def handle_end(self) -> None:
        """The process has ended. Its records are kept, because the next start begins at 0."""
        if self.link is not None:
            self.ended_links.append(self.link)
            del self._told[GatewayMetrics, ""]
        for key, told in self._told.items():
            ended = self._ended.get(key)
            self._ended[key] = told if ended is None else plus(ended, told)
        self._told = {}

    def handle_resumed(self, now_ns: int) -> None:
        """The process starts again after a stop that was asked for: it has shown nothing yet."""
        self._resumed_ns = now_ns
        for records in (self._ended, self._told):
            for key, record in records.items():
                if isinstance(record, DisplayMetrics):
                    records[key] = replace(record, age_ns=None, state=State.NOTHING)

    def links(self) -> Iterator[GatewayMetrics]:
        """The link's counters of each start."""
        yield from self.ended_links
        if self.link is not None:
            yield self.link


#: Rows with stamps that travelled from the other end.
_DATED = frozenset({ShownRow, LightRow, ClickRow})


class Collector:
    """Takes the messages of every process of `topology`."""

    def __init__(self, topology: Topology) -> None:
        self.topology, self.setup = topology, topology.setup
        self.streams = {row.name: StreamMetrics() for row in topology.media_streams}
        #: By process: the stream of which it is one end.
        self._ends = {
            process: row.name
            for row in topology.media_streams
            for process in (row.sender, row.receiver)
        }
        #: What is shown and heard of a partner: from capture to display.
        self.partner = {RTC_CAMERA: Histogram(), RTC_VOICE: Histogram()}
        self.haptics = {
            row.key: HapticMetrics(topology.setup.profile(row.direction).insert_octets)
            for row in topology.haptics
        }
        #: By process: the samples that it sends, and those that it receives.
        self._sampled = {row.sender: self.haptics[row.key] for row in topology.haptics}
        self._felt = {row.receiver: self.haptics[row.key] for row in topology.haptics}
        self.processes: dict[str, ProcessMetrics] = {}
        self.skews = {name: Skew() for name in ("video_haptic", "audio_haptic", "audio_video")}
        self.lip_sync = LipSyncShare()
        #: Of the gateway of this machine, if the other one is on another machine.
        self.clock = ClockHistory()
        #: The same by content: contacts, and when each was seen, heard and felt.
        self.sync = SyncMetrics(soonest_ns=round(topology.setup.radio_profile.delay_ms * NS_PER_MS))
        #: The rows for a join, if the other end is on another machine.
        self.trace = None if topology.alone is None else Trace()

    def process(self, name: str) -> ProcessMetrics:
        metrics = self.processes.get(name)
        if metrics is None:
            metrics = self.processes[name] = ProcessMetrics()
        return metrics

    def gateway(self, segment: Segment) -> ProcessMetrics:
        return self.process(self.topology.gateway(segment).name)

    def shown(self, stream: str) -> DisplayMetrics:
        return self.process(self.topology.media(stream).display).total(DisplayMetrics, stream)

    def received(self, stream: str) -> ReceiverCounts:
        metrics = self.process(self.topology.media(stream).receiver)
        found = metrics.find(VideoReceiverCounts) or metrics.find(VoiceReceiverCounts)
        return ReceiverCounts() if found is None else found.rtp

    def handle_message(self, process: str, message: Message, now_ns: int) -> None:
        metrics = self.process(process)
        metrics.handle_message(message, now_ns)
        for series in message.series:
            self._handle_series(process, metrics, series, now_ns)
            # What was shown before the other clock was known has stamps of no clock.
            if self.trace is not None and (self.clock.known or series.kind not in _DATED):
                self.trace.add(process, series)
        # A second later the messages of all senses about an instant have come.
        self._compare(now_ns - NS_PER_S)
        self.sync.handle_time(now_ns, self.haptics["up"].sent_ns_at)

    def handle_exit(self, process: str, error: str) -> None:
        """A process has ended, and its next start counts from 0.

        error: why, in one line; "" if none of its starts has ended unasked.
        """
        metrics = self.process(process)
        metrics.handle_end()
        metrics.last_error = error or None

    def handle_resumed(self, now_ns: int) -> None:
        """The processes are started again after a stop that was asked for."""
        for metrics in self.processes.values():
            metrics.handle_resumed(now_ns)

    def handle_end(self) -> None:
        """The session is over. Compare what still waits."""
        self._compare(None)

    def _handle_series(
        self, process: str, metrics: ProcessMetrics, series: Series[Any], now_ns: int
    ) -> None:
        kind = series.kind
        if kind is ClockRow:
            for row in series.rows():
                self.clock.add(*row)
            return
        if process == SECOND_ROBOT and kind is not LatenessRow:
            # A partner's: nothing of it is felt, seen or heard in space.
            return
        if process == RTC_DISPLAY and kind is ShownRow:
            shown = np.frombuffer(series.values, np.int64).reshape(-1, series.width)
            self.partner[series.stream].add(shown[:, 2] - shown[:, 1])
            return
        if kind in PERCEIVED:
            self.sync.handle_series(series)
            return
        rows = np.frombuffer(series.values, np.int64).reshape(-1, series.width)
        if kind is LatenessRow:
            metrics.lateness.add(rows)
        elif kind is SendingRow:
            metrics.sending.add(rows)
        elif kind is SampleSentRow:
            self._sampled[process].handle_sent(rows, now_ns)
        elif kind is SampleReceivedRow:
            self._felt[process].handle_received(rows, now_ns)
        else:
            stream = self.streams[series.stream or self._ends[process]]
            if kind is ShownRow and self.topology.alone is not None:
                self._note_dating(stream, rows)
            stream.handle_rows(kind, rows, now_ns)

    def _note_dating(self, stream: StreamMetrics, rows: NDArray[np.int64]) -> None:
        """Pictures and sounds of another machine came: are their stamps known in this clock?"""
        stream.dated = self.clock.known
        if self.clock.known:
            errors_ns = self.clock.at(rows[:, 2]).errors_ns
            stream.error_ns = max(stream.error_ns, int(errors_ns.max(initial=0)))

    def _compare(self, until_ns: int | None) -> None:
        """The skews at the operator in space, who sees, hears and feels the ground."""
        force = self.haptics["up"].recent
        video, audio = self.streams.get("uplink_video"), self.streams.get("uplink_voice")
        for metrics, name in ((video, "video_haptic"), (audio, "audio_haptic")):
            if metrics is None:
                continue
            while metrics.fresh and (until_ns is None or metrics.fresh[0][0] <= until_ns):
                displayed_ns, latency_ns = metrics.fresh.popleft()
                felt_ns = force.at(displayed_ns)
                if felt_ns is not None:
                    self.skews[name].add(latency_ns - felt_ns)
                if metrics is video and audio is not None:
                    heard_ns = audio.recent.at(displayed_ns)
                    if heard_ns is not None:
                        self.skews["audio_video"].add(heard_ns - latency_ns)
                        self.lip_sync.add(displayed_ns, heard_ns - latency_ns)
