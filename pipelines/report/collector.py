"""Joins what the processes of a session report; the only source of its report. A core."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.meters import Histogram
from kontur_av.rtp.receiver import ReceiverCounts
from kontur_av.streams.video_receiver import VideoReceiverCounts
from kontur_av.streams.voice_receiver import VoiceReceiverCounts
from pipelines.media.figures import DisplayFigures
from pipelines.report.journeys import HapticFigures, LipSyncShare, Skew, StreamFigures
from pipelines.report.process_figures import ProcessFigures
from pipelines.report.sync_figures import PERCEIVED, SyncFigures
from pipelines.report.trace import Trace
from pipelines.session.probe import Message, Series
from pipelines.session.rows import (
    ClickRow,
    ClockRow,
    LatenessRow,
    LightRow,
    SampleReceivedRow,
    SampleSentRow,
    SendingRow,
    ShownRow,
)
from pipelines.session.topology import (
    RTC_CAMERA,
    RTC_DISPLAY,
    RTC_VOICE,
    SECOND_ROBOT,
    Segment,
    Topology,
)
from telepresence.link.clock.estimator import ClockHistory

#: Rows with stamps that travelled from the other end.
_DATED = frozenset({ShownRow, LightRow, ClickRow})


class Collector:
    """Takes the messages of every process of `topology`."""

    def __init__(self, topology: Topology) -> None:
        self.topology, self.setup = topology, topology.setup
        self.streams = {row.name: StreamFigures() for row in topology.media_streams}
        #: By process: the stream of which it is one end.
        self._ends = {
            process: row.name
            for row in topology.media_streams
            for process in (row.sender, row.receiver)
        }
        #: What is shown and heard of a partner: from capture to display.
        self.partner = {RTC_CAMERA: Histogram(), RTC_VOICE: Histogram()}
        self.haptics = {
            row.key: HapticFigures(topology.setup.profile(row.direction).insert_octets)
            for row in topology.haptics
        }
        #: By process: the samples that it sends, and those that it receives.
        self._sampled = {row.sender: self.haptics[row.key] for row in topology.haptics}
        self._felt = {row.receiver: self.haptics[row.key] for row in topology.haptics}
        self.processes: dict[str, ProcessFigures] = {}
        self.skews = {name: Skew() for name in ("video_haptic", "audio_haptic", "audio_video")}
        self.lip_sync = LipSyncShare()
        #: Of the gateway of this machine, if the other one is on another machine.
        self.clock = ClockHistory()
        #: The same by content: contacts, and when each was seen, heard and felt.
        self.sync = SyncFigures(soonest_ns=round(topology.setup.radio_profile.delay_ms * NS_PER_MS))
        #: The rows for a join, if the other end is on another machine.
        self.trace = None if topology.alone is None else Trace()

    def process(self, name: str) -> ProcessFigures:
        figures = self.processes.get(name)
        if figures is None:
            figures = self.processes[name] = ProcessFigures()
        return figures

    def gateway(self, segment: Segment) -> ProcessFigures:
        return self.process(self.topology.gateway(segment).name)

    def shown(self, stream: str) -> DisplayFigures:
        """The counts of the display that shows a stream."""
        return self.process(self.topology.media(stream).display).total(DisplayFigures, stream)

    def received(self, stream: str) -> ReceiverCounts:
        figures = self.process(self.topology.media(stream).receiver)
        found = figures.find(VideoReceiverCounts) or figures.find(VoiceReceiverCounts)
        return ReceiverCounts() if found is None else found.rtp

    def handle_message(self, process: str, message: Message, now_ns: int) -> None:
        figures = self.process(process)
        figures.handle_message(message, now_ns)
        for series in message.series:
            self._handle_series(process, figures, series, now_ns)
            # What was shown before the other clock was known has stamps of no clock.
            if self.trace is not None and (self.clock.known or series.kind not in _DATED):
                self.trace.add(process, series)
        # A second later the messages of all senses about an instant have come.
        self._compare(now_ns - NS_PER_S)
        self.sync.handle_time(now_ns, self.haptics["up"].sent_ns_at)

    def handle_exit(self, process: str, error: str) -> None:
        """A process has ended, and its next life counts from 0.

        error: why, in one line; "" if none of its lives has ended unasked.
        """
        figures = self.process(process)
        figures.handle_end()
        figures.last_error = error or None

    def handle_resumed(self, now_ns: int) -> None:
        """The processes are started again after a stop that was asked for."""
        for figures in self.processes.values():
            figures.handle_resumed(now_ns)

    def handle_end(self) -> None:
        """The session is over. Compare what still waits."""
        self._compare(None)

    def _handle_series(
        self, process: str, figures: ProcessFigures, series: Series[Any], now_ns: int
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
            figures.lateness.add(rows)
        elif kind is SendingRow:
            figures.sending.add(rows)
        elif kind is SampleSentRow:
            self._sampled[process].handle_sent(rows, now_ns)
        elif kind is SampleReceivedRow:
            self._felt[process].handle_received(rows, now_ns)
        else:
            stream = self.streams[series.stream or self._ends[process]]
            if kind is ShownRow and self.topology.alone is not None:
                self._note_dating(stream, rows)
            stream.handle_rows(kind, rows, now_ns)

    def _note_dating(self, stream: StreamFigures, rows: NDArray[np.int64]) -> None:
        """Pictures and sounds of another machine came: are their stamps known in this clock?"""
        stream.dated = self.clock.known
        if self.clock.known:
            errors_ns = self.clock.at(rows[:, 2]).errors_ns
            stream.error_ns = max(stream.error_ns, int(errors_ns.max(initial=0)))

    def _compare(self, until_ns: int | None) -> None:
        """The skews at the operator in space, who sees, hears and feels the ground."""
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
                        self.lip_sync.add(displayed_ns, heard_ns - latency_ns)
