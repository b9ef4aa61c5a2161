"""`kontur-av send`: one stream from a source to plain RTP over UDP, under a hard cap."""

import argparse

from msgspec.structs import replace

from kontur_av.codecs.coding import REFRESH_S, SLOW_REFRESH_S
from kontur_av.codecs.encoder_settings import SEARCHES
from kontur_av.media import VIDEO_CODECS, parse_size
from kontur_av.streams.sending import send
from pipelines.commands.common import check_options
from pipelines.media.sending import scenes_of
from pipelines.report.report_file import check_writable, end_with
from pipelines.session.command_process import reader_gone, say, stopped_by_signals
from pipelines.session.option_rows import add_options


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_options(parser.add_mutually_exclusive_group(required=True), "--video", "--audio")
    add_options(
        parser,
        "--to HOST:PORT <!>  RTCP goes to PORT+1",
        "--cap-kbps K <float!>  hard cap on RTP payload over any second, in kbit/s",
        "--channel-kbps C <float>  the rate at which packets of a picture leave (default: the cap)",
    )
    add_options(
        parser,
        "--size",
        "--fps",
        "--coded-size WxH <=auto>  of pictures as coded; receivers scale them up (default: auto, "
        "as large as there are bits for)",
        "--refresh-s S <float>  renew the whole picture every S seconds (default: "
        f"{SLOW_REFRESH_S:g} while a receiver gives feedback, else {REFRESH_S:g})",
        f"--codec <{'|'.join(VIDEO_CODECS)}=h264>  h265 (HEVC) computes more, and often looks "
        "better (default: h264)",
        f"--search <{'|'.join(SEARCHES)}=thorough>  quick: half the computing for 1 dB, of "
        "pictures not coded small (default: thorough)",
        "--seconds",
        "--sdp FILE <Path>  write what receivers need to know",
        "--report",
    )


def run(args: argparse.Namespace) -> int:
    """Send until the time is over or Ctrl-C. Exit code 0 or 1.

    Raises ConfigError, with nothing sent, for what cannot work.
    """
    check_options(args, "cap_kbps", "channel_kbps")
    check_writable(args.report)
    auto, sound = args.coded_size == "auto", args.video is None
    spec = args.audio if sound else args.video
    with stopped_by_signals() as stopped:
        report = send(
            spec,
            args.to,
            cap_bps=round(args.cap_kbps * 1000),
            sound=sound,
            size=parse_size(args.size),
            fps=args.fps,
            codec=args.codec,
            channel_bps=None if args.channel_kbps is None else round(args.channel_kbps * 1000),
            coded_size=None if auto else parse_size(args.coded_size, "--coded-size"),
            refresh_s=args.refresh_s,
            search=args.search,
            sdp=args.sdp,
            scenes=scenes_of(spec, sound=sound),
            seconds=args.seconds,
            stopped=lambda: stopped() or reader_gone(),
            say=say,
        )
    # Who reads no more has not waited for the first picture.
    failed = report.failed if report.sender.frames_sent or not reader_gone() else []
    return end_with(args.report, replace(report, failed=failed), failed)
