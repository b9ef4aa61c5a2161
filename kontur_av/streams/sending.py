"""Sends a stream in real time, and reports it. A shell."""

import time
from collections.abc import Callable, Mapping
from contextlib import closing, suppress
from operator import index
from pathlib import Path
from typing import Any

from kontur_av.clock import NS_PER_MS, NS_PER_S, MonotonicClock
from kontur_av.codecs.encoder_settings import SEARCHES, Search
from kontur_av.errors import number, one_of, refused, whole
from kontur_av.hosts import check_reachable, parse_address
from kontur_av.media import VIDEO_CODECS, VideoCodec
from kontur_av.meters import Histogram
from kontur_av.report import Latency, Report, latency_ms, rates
from kontur_av.sources import AudioSource, VideoSource, open_audio, open_video
from kontur_av.sources.live import LiveCapture
from kontur_av.streams.budget import LEAST_BPS, MOST_BPS
from kontur_av.streams.encoding_thread import switch_threads_often
from kontur_av.streams.feeds import PictureFeed, SoundFeed, checked_sdp, write_description
from kontur_av.streams.paced_sender import UnitSent
from kontur_av.streams.sent_stream import SentStream
from kontur_av.streams.udp import UdpSender


class SentStages(Report, frozen=True, kw_only=True):
    """Latencies since the capture; of sound, without the codec's look-ahead."""

    capture_to_encoded: Latency
    capture_to_sent: Latency


class SentLatency(Report, frozen=True, kw_only=True):
    """The latencies of `send`."""

    stages: SentStages


class SourceReport(Report, frozen=True, kw_only=True):
    """The faults of the source; `last_fault` is empty if there was none."""

    faults: int
    last_fault: str
    #: What dates its pictures: `source` (the camera itself) or `arrival`; of cameras only.
    dated_by: str | None = None


class SendReport(SentStream, frozen=True, kw_only=True):
    """The report of `send`; `failed` says what went wrong."""

    stream: str
    seconds: float
    rtp_payload_octets: int
    send_errors: int
    latency_ms: SentLatency
    source: SourceReport
    cpu_s: float
    failed: list[str]


_LONGEST_WAIT_NS = 50 * NS_PER_MS


class SendShell:
    """Drives source and sender in real time.

    say: takes a line of figures each second.
    """

    def __init__(
        self,
        feed: PictureFeed | SoundFeed,
        udp: UdpSender,
        clock: MonotonicClock,
        say: Callable[[str], object] | None = None,
    ) -> None:
        self._feed = feed
        self._say = say
        self._sender = feed.sender
        self._udp = udp
        self._clock = clock
        self._encoded_ns = Histogram()
        self._sent_ns = Histogram()
        self._told_faults = 0

    def run(self, stopped: Callable[[], bool], seconds: float | None = None) -> SendReport:
        """Send until the time is over, `stopped`, or Ctrl-C."""
        start_ns = self._clock.now_ns()
        end_ns = None if seconds is None else start_ns + round(seconds * NS_PER_S)
        next_line_ns = start_ns + NS_PER_S
        with suppress(KeyboardInterrupt):
            while not stopped():
                now_ns = self._clock.now_ns()
                if end_ns is not None and now_ns >= end_ns:
                    break
                if now_ns >= next_line_ns:
                    next_line_ns += NS_PER_S
                    self._line(now_ns, start_ns)
                self._step(now_ns, end_ns, next_line_ns)
        self._drain_rest()
        self._udp.say_goodbye(self._sender, self._clock)
        return self._report(start_ns)

    def _step(self, now_ns: int, end_ns: int | None, next_line_ns: int) -> None:
        due = (self._sender.poll_timeout(), end_ns, next_line_ns)
        until_ns = min(instant for instant in due if instant is not None)
        timeout_ns = min(max(until_ns - now_ns, 0), _LONGEST_WAIT_NS)
        self._feed.step(timeout_ns)
        self._transmit()

    def _transmit(self) -> None:
        sender = self._sender
        self._udp.exchange(sender, self._clock)
        while (event := sender.next_event()) is not None:
            if isinstance(event, UnitSent):
                begin_ns = event.capture_ns + self._feed.lookahead_ns
                self._encoded_ns.add(event.encoded_ns - begin_ns)
                self._sent_ns.add(event.sent_ns - begin_ns)

    def _drain_rest(self) -> None:
        """Send what is queued, so that the last picture is whole; for a second at most."""
        give_up_ns = self._clock.now_ns() + NS_PER_S
        self._feed.finish()
        while (due_ns := self._sender.poll_timeout()) is not None and due_ns < give_up_ns:
            self._clock.sleep_until_ns(due_ns)
            self._transmit()

    def _line(self, now_ns: int, start_ns: int) -> None:
        if self._say is None:
            return
        source = self._feed.source
        if source.faults > self._told_faults:
            self._told_faults = source.faults
            self._say(source.last_fault)
        counts, released = self._sender.counts, self._sender.released
        self._say(
            f"{(now_ns - start_ns) / NS_PER_S:6.0f} s  {counts.frames_captured} captured, "
            f"{counts.frames_sent} sent in {released.events} packets, "
            f"{released.mean_bps(now_ns) / 1000:.1f} of {self._sender.cap_bps / 1000:g} kbit/s, "
            f"capture to sent {self._sent_ns.percentile(95) / NS_PER_MS:.1f} ms (95 %)"
        )

    def _report(self, start_ns: int) -> SendReport:
        feed, sender, now_ns = self._feed, self._sender, self._clock.now_ns()
        counts, released = sender.counts, sender.released
        failed = []
        if not counts.frames_sent:
            failed.append(f"nothing was captured: {feed.source.last_fault or 'the source is mute'}")
        if released.max_bps(NS_PER_S) > sender.cap_bps:
            failed.append("the cap was broken")
        if self._udp.failed:
            failed.append(f"{self._udp.failed} datagrams could not be sent")
        return SendReport(
            stream=feed.kind,
            seconds=(now_ns - start_ns) / NS_PER_S,
            cap_bps=sender.cap_bps,
            **rates(released),
            sender=counts,
            rtp_payload_octets=released.octets,
            send_errors=self._udp.failed,
            latency_ms=SentLatency(
                stages=SentStages(
                    capture_to_encoded=latency_ms(self._encoded_ns),
                    capture_to_sent=latency_ms(self._sent_ns),
                )
            ),
            source=SourceReport(
                faults=feed.source.faults,
                last_fault=feed.source.last_fault,
                dated_by=feed.source.dated_by if isinstance(feed.source, LiveCapture) else None,
            ),
            cpu_s=time.process_time(),
            size=feed.size if isinstance(feed, PictureFeed) else None,
            coded_size=feed.coded_size if isinstance(feed, PictureFeed) else None,
            encoder=feed.encoder if isinstance(feed, PictureFeed) else None,
            failed=failed,
        )


def send(
    source: str | VideoSource | AudioSource,
    to: str,
    *,
    cap_bps: int,
    sound: bool = False,
    size: tuple[int, int] = (640, 480),
    fps: float = 30,
    codec: VideoCodec = "h264",
    channel_bps: int | None = None,
    coded_size: tuple[int, int] | None = None,
    refresh_s: float | None = None,
    search: Search = "thorough",
    sdp: str | Path | None = None,
    scenes: Mapping[str, Any] | None = None,
    seconds: float | None = None,
    stopped: Callable[[], bool] = lambda: False,
    say: Callable[[str], object] | None = None,
) -> SendReport:
    """Send a source as `kontur-av send` does; return the report.

    source: a SPEC as of `open_video`: a file, `v4l2:/dev/video0`, `pipe:PATH` or a class of yours;
    or an open source of this size and rate. With `sound` as of `open_audio`: `alsa:default`.
    to: HOST:PORT or [IPv6]:PORT. RTCP goes to the next port.
    cap_bps: of RTP payload, in any second. channel_bps: the rate at which the packets of a picture
    leave; None: the cap.
    size, fps, codec, coded_size, refresh_s, search: of pictures, as of `VideoEncoder`.
    sdp: a file for the receiver, written before the first packet.
    scenes: as of `open_video` or `open_audio`.
    seconds, stopped: when to end: after this time, once it returns True, or at Ctrl-C.
    say: takes a line of figures each second, such as `print`.

    Raises ConfigError, with nothing sent, for what cannot work.
    """
    cap_bps = whole(cap_bps, "cap_bps", least=LEAST_BPS, most=MOST_BPS)
    address, clock = parse_address(str(to), "to"), MonotonicClock()
    fps = number(fps, "fps", least=1, most=120)
    codec, search = one_of(codec, VIDEO_CODECS, "codec"), one_of(search, SEARCHES, "search")
    with refused(f"size {size!r}: give (width, height)", TypeError, ValueError):
        width, height = map(index, size)
    if refresh_s is not None:
        refresh_s = number(refresh_s, "refresh_s", least=0.1, most=600)
    if seconds is not None:
        seconds = number(seconds, "seconds", least=0.01, most=1e9)
    path = checked_sdp(sdp)
    feed: PictureFeed | SoundFeed
    if sound:
        heard: Any = source
        if isinstance(source, str):
            heard = open_audio(source, name="audio", clock=clock, scenes=scenes)
        feed = SoundFeed(heard, clock, cap_bps=cap_bps, channel_bps=channel_bps)
    else:
        switch_threads_often()
        seen: Any = source
        if isinstance(source, str):
            seen = open_video(
                source,
                name="video",
                width=width,
                height=height,
                fps=fps,
                clock=clock,
                scenes=scenes,
            )
        feed = PictureFeed(
            seen,
            clock,
            size=(width, height),
            fps=fps,
            cap_bps=cap_bps,
            channel_bps=channel_bps,
            coded_size=coded_size,
            refresh_s=refresh_s,
            search=search,
            codec=codec,
        )
    with closing(feed):
        if path is not None:
            write_description(feed, address, path)
        check_reachable(address)
        with closing(UdpSender(*address)) as udp:
            return SendShell(feed, udp, clock, say).run(stopped, seconds)
