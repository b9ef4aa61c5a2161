"""`kontur-av watch`: a picture and a voice from a media server, by WebRTC and WHEP."""

import argparse
import asyncio
import time
from contextlib import closing

from kontur_av.clock import MonotonicClock
from pipelines.commands.common import check_options
from pipelines.commands.rtc_options import ICE
from pipelines.commands.rtc_running import OUTPUT, PartnerOutput, keep, keeper_of
from pipelines.partner.ice_servers import IceServers
from pipelines.partner.peer import RtcCommandReport, RtcPeer
from pipelines.report.report_file import end_with
from pipelines.session.option_rows import add_options
from pipelines.session.options import add_session_options


def add_arguments(parser: argparse.ArgumentParser) -> None:
    row = "--whep URL <!>  the endpoint (draft-ietf-wish-whep)"
    add_options(parser, row, "--token", "--token-file", "--token-origin", *OUTPUT)
    add_session_options(parser, *ICE, "seconds", "report")


def run(args: argparse.Namespace) -> int:
    """Watch until the time is over or Ctrl-C. Exit code 0 or 1.

    Raises ConfigError for what cannot work.
    """
    check_options(args)
    report = asyncio.run(_watch(args))
    return end_with(args.report, report, report.failed)


async def _watch(args: argparse.Namespace) -> RtcCommandReport:
    clock = MonotonicClock()
    begin_s = time.monotonic()
    with closing(PartnerOutput(args, clock)) as output:

        def make_peer(found: IceServers) -> RtcPeer:
            return RtcPeer(
                clock=clock,
                sends={},
                receives=("audio", "video"),
                handle=output.handle,
                servers=found,
            )

        keeper = keeper_of(args, args.whep, make_peer, clock)
        newest = await keep(args.seconds, keeper, output.flush)
        pictures, voice = output.pictures(), output.voice()
        failed = output.finish()
        if not keeper.attempts.stood:
            failed.append(f"no connection to {args.whep}: {keeper.fault or 'none was made'}")
        elif not pictures.decoded and not voice.decoded:
            failed.append("nothing could be decoded: does anybody send?")
        return RtcCommandReport(
            seconds=time.monotonic() - begin_s,
            connections=keeper.attempts.stood,
            ice_restarts=keeper.attempts.restarts,
            last=newest,
            pictures=pictures,
            voice=voice,
            coded={},
            cpu_s=time.process_time(),
            failed=failed,
        )
