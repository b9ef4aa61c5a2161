"""`kontur-av receive`: receive the stream that an SDP describes, decode it, count, save it."""

import argparse
import contextlib
import selectors
import time
from contextlib import ExitStack, closing
from pathlib import Path

from msgspec.structs import replace

from kontur_av.clock import NS_PER_MS, NS_PER_S, MonotonicClock
from kontur_av.errors import ConfigError
from kontur_av.media import parse_size
from kontur_av.meters import RateMeter
from kontur_av.rtp.sdp import StreamDescription, parse_sdp
from kontur_av.streams.udp import UdpReceiver
from pipelines.commands.common import add_raw_argument, check_options
from pipelines.media.rtp_reports import (
    ReceivedLatency,
    ReceivedStages,
    ReceiveReport,
    SavedReport,
    latency_ms,
)
from pipelines.recording.live_output import LiveWriter
from pipelines.recording.matroska import MatroskaWriter
from pipelines.recording.raw_pictures import RawPictures
from pipelines.recording.received_media import PictureOutput, SoundOutput
from pipelines.report.report_file import check_writable, end_with
from pipelines.session.children import stopped_by_signals
from pipelines.session.output import reader_gone, say

_SILENCE_NS = 5 * NS_PER_S
_SILENCE_AFTER_GOODBYE_NS = NS_PER_S
_LONGEST_WAIT_NS = 200 * NS_PER_MS
#: Of what was decoded; a file that holds less is a failure.
_SAVED_AT_LEAST = 0.9


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--sdp", metavar="FILE", required=True, help="describes the stream")
    parser.add_argument("--save", metavar="FILE.mkv", help="write the stream as it comes")
    parser.add_argument(
        "--to",
        metavar="URL",
        help="hand the stream on as it comes: MPEG-TS to udp://HOST:PORT, or rtsp://HOST/NAME",
    )
    add_raw_argument(parser)
    parser.add_argument(
        "--size", metavar="WxH", help="of the pictures of --raw (default: that of the first one)"
    )
    parser.add_argument("--report", type=Path, metavar="FILE", help="write the report as JSON")
    parser.add_argument(
        "--seconds",
        metavar="S",
        type=float,
        help="also through pauses (default: until Ctrl-C, or until a stream that had begun is "
        "silent for 5 s)",
    )


def run(args: argparse.Namespace) -> int:
    """Receive until the time is over, the stream has ended or Ctrl-C. Exit code 0 or 1.

    Raises ConfigError for what cannot work.
    """
    check_options(args)
    stream = parse_sdp(_read_text(args.sdp))
    with ExitStack() as stack:
        udp = stack.enter_context(
            closing(UdpReceiver(stream.host, stream.port, stream.control_port, stream.sources))
        )
        check_writable(args.report)
        writer: MatroskaWriter | None = None
        if args.save:
            writer = MatroskaWriter(args.save, stream.codec)
            stack.callback(writer.close)
        live = LiveWriter(args.to, stream.codec) if args.to else None
        if live is not None:
            stack.callback(live.close)
        writers = [one for one in (writer, live) if one is not None]
        raw = _open_raw(args, stream)
        if raw is not None:
            stack.callback(raw.close)
        clock = MonotonicClock()
        output: PictureOutput | SoundOutput
        if stream.kind == "video":
            output = PictureOutput(stream, clock, writers, raw)
        else:
            output = SoundOutput(stream, clock, writers)
        report = _ReceiveShell(stream, output, udp, clock, raw).run(args.seconds)
    # What a full disk has taken is not known: FFmpeg writes some seconds at once.
    short = writer is not None and writer.written < _SAVED_AT_LEAST * output.decoded
    failed = report.failed + [one.fault for one in (writer, live, raw) if one and one.fault]
    if writer is not None and short and not writer.fault:
        failed.append(
            f"--save {args.save!r}: {writer.written} of {output.decoded} decoded are in the file"
        )
    report = replace(
        report,
        cpu_s=time.process_time(),
        failed=failed,
        saved=None if writer is None else SavedReport(file=args.save, packets=writer.written),
        forwarded=None if live is None else live.report(),
        raw=None if raw is None else raw.report(),
    )
    return end_with(args.report, report, failed)


def _open_raw(args: argparse.Namespace, stream: StreamDescription) -> RawPictures | None:
    size = None if args.size is None else parse_size(args.size)
    if args.raw is None:
        if size is not None:
            raise ConfigError("--size is that of the pictures of --raw: give --raw PATH, too")
        return None
    if stream.kind != "video":
        raise ConfigError("--raw writes pictures, but the SDP describes sound: leave it out")
    return RawPictures(args.raw, size)


def _read_text(path: str) -> str:
    try:
        return Path(path).read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise ConfigError(f"--sdp {path!r} cannot be read: {error.strerror}") from None


class _ReceiveShell:
    """Drives sockets and receiver in real time."""

    def __init__(
        self,
        stream: StreamDescription,
        output: PictureOutput | SoundOutput,
        udp: UdpReceiver,
        clock: MonotonicClock,
        raw: RawPictures | None,
    ) -> None:
        self._raw = raw
        self._watched: int | None = None
        self._stream = stream
        self._clock = clock
        self._output = output
        self._receiver = output.receiver
        self._udp = udp
        self._rate = RateMeter()
        self._last_packet_ns: int | None = None
        self._payload_octets = 0

    def run(self, seconds: float | None) -> ReceiveReport:
        """Receive until the end; the report, without the outputs."""
        start_ns = self._clock.now_ns()
        end_ns = None if seconds is None else start_ns + round(seconds * NS_PER_S)
        next_line_ns = start_ns + NS_PER_S
        say(f"waiting for {self._stream.kind} on UDP port {self._stream.port}")
        with stopped_by_signals() as stopped, selectors.DefaultSelector() as selector:
            for one in self._udp.sockets:
                selector.register(one, selectors.EVENT_READ)
            while not (stopped() or reader_gone()):
                now_ns = self._clock.now_ns()
                if self._has_ended(now_ns) if end_ns is None else now_ns >= end_ns:
                    break
                if now_ns >= next_line_ns:
                    next_line_ns += NS_PER_S
                    self._line(now_ns - start_ns)
                due = [self._receiver.poll_timeout(), end_ns]
                until_ns = min([next_line_ns, *(d for d in due if d is not None)])
                wait_ns = min(max(until_ns - now_ns, 0), _LONGEST_WAIT_NS)
                if self._raw is not None:
                    self._watch(selector, self._raw.pending())
                selector.select(wait_ns / NS_PER_S)
                self._udp.exchange(self._receiver, self._clock)
                self._note(self._clock.now_ns())
                self._output.drain()
                if self._raw is not None and self._raw.pending() is not None:
                    self._raw.handle_writable()
            self._output.finish()
        return self._report(start_ns)

    def _watch(self, selector: selectors.BaseSelector, wanted: int | None) -> None:
        """Wake when the reader of raw pictures can take the rest of a picture."""
        if self._watched is not None:
            # The descriptor may have been closed, or another one of its number opened.
            with contextlib.suppress(KeyError, ValueError):
                selector.unregister(self._watched)
        if wanted is not None:
            selector.register(wanted, selectors.EVENT_WRITE)
        self._watched = wanted

    def _has_ended(self, now_ns: int) -> bool:
        if self._last_packet_ns is None:
            return False
        ended = self._receiver.ended
        patience_ns = _SILENCE_AFTER_GOODBYE_NS if ended else _SILENCE_NS
        return now_ns - self._last_packet_ns > patience_ns

    def _note(self, now_ns: int) -> None:
        """Count the payload that has come since the last call."""
        octets = self._receiver.counts.rtp.rtp_payload_octets
        if octets > self._payload_octets:
            self._last_packet_ns = now_ns
            self._rate.add(now_ns, octets - self._payload_octets)
            self._payload_octets = octets

    def _line(self, passed_ns: int) -> None:
        counts = self._receiver.counts.rtp
        latency = self._output.decoded_ns
        say(
            f"{passed_ns / NS_PER_S:6.0f} s  {counts.rtp_packets} packets, {counts.rtp_lost} lost, "
            f"{self._output.decoded} decoded, {self._rate.mean_bps() / 1000:.1f} kbit/s"
            + (
                f", latency {latency.percentile(95) / NS_PER_MS:.1f} ms (95 %)"
                if latency.count
                else ""
            )
        )

    def _report(self, start_ns: int) -> ReceiveReport:
        counts, rate, output = self._receiver.counts.rtp, self._rate, self._output
        latency = None
        if output.decoded_ns.count:
            latency = ReceivedLatency(
                **output.decoded_ns.summary_ms(),
                stages=ReceivedStages(capture_to_received=latency_ms(output.received_ns)),
                clock="the wall clocks of both hosts",
            )
        failed = []
        if not counts.rtp_packets:
            failed.append(f"no packet came to UDP port {self._stream.port}: {self._what_came()}")
        elif not output.decoded:
            failed.append(
                f"{counts.rtp_packets} packets came, but nothing could be decoded"
                + self._output.missing()
            )
        return ReceiveReport(
            stream=self._stream.kind,
            seconds=(self._clock.now_ns() - start_ns) / NS_PER_S,
            seconds_of_stream=((rate.last_ns or 0) - (rate.first_ns or 0)) / NS_PER_S,
            payload_bps_mean=rate.mean_bps(),
            payload_bps_max_1s=rate.max_bps(NS_PER_S),
            payload_bps_max_100ms=rate.max_bps(100 * NS_PER_MS),
            output=output.report(),
            latency_ms=latency,
            cpu_s=0.0,
            failed=failed,
        )

    def _what_came(self) -> str:
        """Say what came instead of the stream's packets."""
        counts, other = self._receiver.counts.rtp, self._receiver.other_payload_type
        if other is not None:
            return (
                f"those that came have payload type {other}, not the {self._stream.payload_type} "
                "of the SDP: take the sender's SDP"
            )
        if self._udp.reported:
            return "only the sender's reports came (RTCP): is there a firewall before this port?"
        if counts.garbage:
            return f"{counts.garbage} datagrams came that are not RTP"
        return "is the sender running?"
