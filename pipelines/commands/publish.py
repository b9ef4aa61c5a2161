"""`kontur-av publish`: a picture and a voice to a media server, by WebRTC and WHIP."""

import argparse
import asyncio
import time

from kontur_av.clock import MonotonicClock
from kontur_av.errors import ConfigError
from pipelines.commands.common import check_options
from pipelines.commands.rtc_options import ICE
from pipelines.commands.rtc_running import SENDING, coded_sources, keep, keeper_of, sends_of
from pipelines.partner.ice_servers import IceServers
from pipelines.partner.peer import RtcCommandReport, RtcPeer
from pipelines.report.report_file import end_with
from pipelines.session.option_rows import add_options
from pipelines.session.options import add_session_options


def add_arguments(parser: argparse.ArgumentParser) -> None:
    row = "--whip URL <!>  the endpoint (RFC 9725)"
    add_options(parser, row, "--token", "--token-file", "--token-origin", *SENDING)
    add_session_options(parser, *ICE, "seconds", "report")


def run(args: argparse.Namespace) -> int:
    """Publish until the time is over or Ctrl-C. Exit code 0 or 1.

    Raises ConfigError for what cannot work.
    """
    check_options(args)
    if args.video is None and args.audio is None:
        raise ConfigError("nothing to publish: give --video SPEC, --audio SPEC or both")
    report = asyncio.run(_publish(args))
    return end_with(args.report, report, report.failed)


async def _publish(args: argparse.Namespace) -> RtcCommandReport:
    clock, sends = MonotonicClock(), sends_of(args)

    def make_peer(found: IceServers) -> RtcPeer:
        return RtcPeer(clock=clock, sends=sends, want_key=lambda: sources.want_key(), servers=found)

    keeper = keeper_of(args, args.whip, make_peer, clock)
    begin_s = time.monotonic()

    def look() -> None:
        peer = keeper.peer
        sources.wanted = peer is not None and peer.connected
        if peer is not None and peer.media is not None:
            sources.handle_request(peer.media.requested_bps)

    with coded_sources(
        args,
        clock,
        send_unit=lambda unit: None if keeper.peer is None else keeper.peer.send_unit(unit),
        send_opus=lambda opus, stamp: (
            None if keeper.peer is None else keeper.peer.send_opus(opus, stamp)
        ),
    ) as sources:
        newest = await keep(args.seconds, keeper, look)
        failed = []
        if not keeper.attempts.stood:
            failed.append(f"no connection to {args.whip}: {keeper.fault or 'none was made'}")
        if sources.fault:
            failed.append(sources.fault)
        return RtcCommandReport(
            seconds=time.monotonic() - begin_s,
            connections=keeper.attempts.stood,
            ice_restarts=keeper.attempts.restarts,
            last=newest,
            coded=dict(sources.coded),
            rate_bps=sources.rate.bps if args.video is not None else None,
            cpu_s=time.process_time(),
            failed=failed,
        )
