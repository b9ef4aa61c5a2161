"""`kontur-av receive`: receive the stream that an SDP describes, decode it, count, save it."""

import argparse
import time
from contextlib import ExitStack, closing
from pathlib import Path

from msgspec.structs import replace

from kontur_av.clock import MonotonicClock
from kontur_av.errors import ConfigError, refused
from kontur_av.media import parse_size
from kontur_av.report import latency_ms
from kontur_av.rtp.sdp import StreamDescription, parse_sdp
from kontur_av.streams.loudspeaker import Loudspeaker
from kontur_av.streams.udp import UdpReceiver
from pipelines.commands.common import check_options
from pipelines.media.rtp_reports import PlayedReport, SavedReport
from pipelines.recording.live_output import LiveWriter
from pipelines.recording.matroska import MatroskaWriter
from pipelines.recording.raw_pictures import RawPictures
from pipelines.recording.received_media import PictureOutput, ReceiveShell, SoundOutput
from pipelines.report.report_file import check_writable, end_with
from pipelines.session.option_rows import add_options

#: Of what was decoded; a file that holds less is a failure.
_SAVED_AT_LEAST = 0.9


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_options(
        parser,
        "--sdp FILE <!>  describes the stream",
        "--save FILE.mkv  write the stream as it comes",
        "--to URL  hand the stream on as it comes: MPEG-TS to udp://HOST:PORT, or rtsp://HOST/NAME",
        "--raw",
        "--play WHERE <?=default>  the sound: default, alsa:DEVICE or pulse:SINK",
        "--size WxH  of --raw (default: of the first picture)",
        "--report",
        "--seconds S <float>  also through pauses (default: until Ctrl-C, or 5 s of silence once "
        "it has begun)",
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
        speaker = _open_loudspeaker(args.play, stream, clock)
        if speaker is not None:
            stack.callback(speaker.close)
        output: PictureOutput | SoundOutput
        if stream.kind == "video":
            output = PictureOutput(stream, clock, writers, raw)
        else:
            output = SoundOutput(stream, clock, writers, speaker)
        report = ReceiveShell(stream, output, udp, clock, raw).run(args.seconds)
    # What a full disk has taken is not known: FFmpeg writes some seconds at once.
    short = writer is not None and writer.written < _SAVED_AT_LEAST * output.decoded
    failed = report.failed + [one.fault for one in (writer, live, raw) if one and one.fault]
    if speaker is not None and speaker.play_faults:
        failed.append(f"--play {args.play!r} has failed: {speaker.play_fault}")
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
        played=None if speaker is None else _played(args.play, speaker, output),
    )
    return end_with(args.report, report, failed)


def _open_loudspeaker(
    spec: str | None, stream: StreamDescription, clock: MonotonicClock
) -> Loudspeaker | None:
    if spec is None:
        return None
    if stream.kind == "video":
        raise ConfigError("--play plays sound, but the SDP describes pictures: leave it out")
    return Loudspeaker(spec, clock)


def _played(spec: str, speaker: Loudspeaker, output: PictureOutput | SoundOutput) -> PlayedReport:
    assert isinstance(output, SoundOutput)
    return PlayedReport(
        to=spec,
        counts=speaker.counts,
        delay_ms=latency_ms(output.player_ns) if output.player_ns.count else None,
    )


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
    with refused(f"--sdp {path!r} cannot be read"):
        return Path(path).read_text(encoding="utf-8", errors="replace")
