"""Sends a stream in real time, and reports it. A shell."""

import argparse
import time

from kontur_av.clock import NS_PER_MS, NS_PER_S, MonotonicClock
from kontur_av.errors import ConfigError
from kontur_av.media import parse_size
from kontur_av.meters import Histogram
from kontur_av.sources import AudioSource, VideoSource, open_audio, open_video
from kontur_av.sources.live import LiveCapture
from kontur_av.sources.source import FILLED_BY_OTHERS
from kontur_av.streams.encoding_thread import switch_threads_often
from kontur_av.streams.feeds import PictureFeed, SoundFeed
from kontur_av.streams.paced_sender import UnitSent
from kontur_av.streams.udp import UdpSender
from pipelines.media.rtp_reports import (
    SendReport,
    SentLatency,
    SentStages,
    SourceReport,
    latency_ms,
)
from pipelines.session.command_process import reader_gone, say, stopped_by_signals

_LONGEST_WAIT_NS = 100 * NS_PER_MS


class SendShell:
    """Drives source and sender in real time."""

    def __init__(
        self,
        feed: PictureFeed | SoundFeed,
        udp: UdpSender,
        clock: MonotonicClock,
    ) -> None:
        self._feed = feed
        self._sender = feed.sender
        self._udp = udp
        self._clock = clock
        self._encoded_ns = Histogram()
        self._sent_ns = Histogram()
        self._told_faults = 0

    def run(self, seconds: float | None) -> SendReport:
        start_ns = self._clock.now_ns()
        end_ns = None if seconds is None else start_ns + round(seconds * NS_PER_S)
        next_line_ns = start_ns + NS_PER_S
        with stopped_by_signals() as stopped:
            while not (stopped() or reader_gone()):
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
        source = self._feed.source
        if source.faults > self._told_faults:
            self._told_faults = source.faults
            say(source.last_fault)
        counts, released = self._sender.counts, self._sender.released
        say(
            f"{(now_ns - start_ns) / NS_PER_S:6.0f} s  {counts.frames_captured} captured, "
            f"{counts.frames_sent} sent in {released.events} packets, "
            f"{released.mean_bps(now_ns) / 1000:.1f} of {self._sender.cap_bps / 1000:g} kbit/s, "
            f"capture to sent {self._sent_ns.percentile(95) / NS_PER_MS:.1f} ms (95 %)"
        )

    def _report(self, start_ns: int) -> SendReport:
        feed, sender, now_ns = self._feed, self._sender, self._clock.now_ns()
        counts, released = sender.counts, sender.released
        largest_bps = released.max_bps(NS_PER_S)
        failed = []
        if not counts.frames_sent and not reader_gone():
            failed.append(f"nothing was captured: {feed.source.last_fault or 'the source is mute'}")
        if largest_bps > sender.cap_bps:
            failed.append("the cap was broken")
        if self._udp.failed:
            failed.append(f"{self._udp.failed} datagrams could not be sent")
        return SendReport(
            stream=feed.kind,
            seconds=(now_ns - start_ns) / NS_PER_S,
            cap_bps=sender.cap_bps,
            payload_bps_mean=released.mean_bps(),
            payload_bps_max_1s=largest_bps,
            payload_bps_max_100ms=released.max_bps(100 * NS_PER_MS),
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


def open_pictures(args: argparse.Namespace, clock: MonotonicClock) -> VideoSource:
    """The source of `--video`, of `--size` and `--fps`. ConfigError."""
    check_alone(args.video)
    scenes = None
    if args.video.startswith("scene:"):
        from telepresence.world import video_scenes

        scenes = video_scenes()
    width, height = parse_size(args.size)
    return open_video(
        args.video,
        name="video",
        width=width,
        height=height,
        fps=args.fps,
        clock=clock,
        scenes=scenes,
    )


def open_sound(args: argparse.Namespace, clock: MonotonicClock) -> AudioSource:
    """The source of `--audio`. ConfigError."""
    check_alone(args.audio)
    scenes = None
    if args.audio.startswith("scene:"):
        from telepresence.world import audio_scenes

        scenes = audio_scenes()
    return open_audio(args.audio, name="audio", clock=clock, scenes=scenes)


def open_feed(args: argparse.Namespace, clock: MonotonicClock) -> PictureFeed | SoundFeed:
    """What `kontur-av send` sends, coded as its options say. ConfigError."""
    cap_bps = round(args.cap_kbps * 1000)
    channel_bps = None if args.channel_kbps is None else round(args.channel_kbps * 1000)
    if args.video is None:
        return SoundFeed(open_sound(args, clock), clock, cap_bps=cap_bps, channel_bps=channel_bps)
    switch_threads_often()
    if args.refresh_s is not None and not 0.1 <= args.refresh_s <= 600:
        raise ConfigError(f"--refresh-s {args.refresh_s:g}: take 0.1 to 600 seconds")
    auto = args.coded_size == "auto"
    return PictureFeed(
        open_pictures(args, clock),
        clock,
        size=parse_size(args.size),
        fps=args.fps,
        cap_bps=cap_bps,
        channel_bps=channel_bps,
        coded_size=None if auto else parse_size(args.coded_size, "--coded-size"),
        refresh_s=args.refresh_s,
        search=args.search,
        codec=args.codec,
    )


def check_alone(spec: str | None) -> None:
    """ConfigError for a source that only a session has."""
    if spec in FILLED_BY_OTHERS:
        raise ConfigError(
            f"only a session has the source {spec}: give another one, "
            f"or `kontur-av stream --source NAME={spec}`"
        )
