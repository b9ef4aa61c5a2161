"""`kontur-av send`: one stream from a source to plain RTP over UDP, under a hard cap."""

import argparse
from contextlib import closing

from kontur_av.clock import MonotonicClock
from kontur_av.codecs.coding import REFRESH_S, SLOW_REFRESH_S
from kontur_av.codecs.encoder_settings import SEARCHES
from kontur_av.hosts import check_reachable, parse_address
from kontur_av.media import VIDEO_CODECS
from kontur_av.rtp.sdp import write_sdp
from kontur_av.streams.feeds import describe
from kontur_av.streams.udp import UdpSender
from pipelines.commands.common import check_options
from pipelines.media.sending import SendShell, open_feed
from pipelines.report.report_file import check_writable, end_with, write_text
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
        "--coded-size WxH <=auto>  in which pictures are coded; receivers scale them up (default: "
        "auto, as large as there are bits for)",
        "--refresh-s S <float>  renew the whole picture every S seconds (default: "
        f"{SLOW_REFRESH_S:g} while a receiver gives feedback, so that it can ask for a whole "
        f"picture, else {REFRESH_S:g})",
        f"--codec <{'|'.join(VIDEO_CODECS)}=h264>  of pictures: h265 (HEVC) computes more, and "
        "often looks better (default: h264)",
        f"--search <{'|'.join(SEARCHES)}=thorough>  for the best way to code pictures that are "
        "not coded small: quick takes half the time and loses 1 dB (default: thorough)",
        "--seconds",
        "--sdp FILE <Path>  write what receivers need to know",
        "--report",
    )


def run(args: argparse.Namespace) -> int:
    """Send until the time is over or Ctrl-C. Exit code 0 or 1.

    Raises ConfigError, with nothing sent, for what cannot work.
    """
    check_options(args, "cap_kbps", "channel_kbps")
    address = parse_address(args.to)
    clock = MonotonicClock()
    with closing(open_feed(args, clock)) as feed:
        stream = describe(feed, *address)
        if args.sdp:
            check_writable(args.sdp, "--sdp")
            write_text(args.sdp, write_sdp(stream))
        check_writable(args.report)
        check_reachable(address)
        with closing(UdpSender(*address)) as udp:
            report = SendShell(feed, udp, clock).run(args.seconds)
    return end_with(args.report, report, report.failed)
