"""`kontur-av rtc serve`: a partner comes to us, by WebRTC with WHIP and WHEP, or by our page."""

import argparse
import asyncio
import secrets
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from kontur_av.clock import MonotonicClock
from pipelines.commands.common import check_options
from pipelines.commands.rtc_options import ICE, ice_servers_of, token_of
from pipelines.commands.rtc_running import (
    OUTPUT,
    SENDING,
    PartnerOutput,
    coded_sources,
    driven,
    sends_of,
)
from pipelines.partner.peer import Programme, RtcCommandReport, connection_report
from pipelines.partner.server import RtcServer
from pipelines.report.report_file import end_with
from pipelines.session.command_process import say
from pipelines.session.option_rows import add_actions, add_options
from pipelines.session.options import add_session_options, stream_options
from pipelines.session.page_sockets import PageListener
from pipelines.session.served_pages import base_url, bound_server, served

#: The only programme of this command.
_NAME = "main"
_SEAT = "rtc"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    rows = (
        "serve a partner, which sees, hears, is seen and is heard",
        "--http [HOST:]PORT <!>  where; TLS beyond loopback",
        "--cert FILE <Path>  PEM file with certificate and key (default: made)",
    )
    serve = add_actions(parser, {"serve": rows})["serve"]
    add_options(serve, "--token", "--token-file", *SENDING, *OUTPUT)
    add_session_options(serve, *ICE, "seconds", "report")


def run(args: argparse.Namespace) -> int:
    """Serve until the time is over or Ctrl-C. Exit code 0 or 1.

    Raises ConfigError for what cannot work.
    """
    check_options(args)
    report = asyncio.run(_serve(args))
    return end_with(args.report, report, report.failed)


@contextmanager
def _listening(args: argparse.Namespace) -> Iterator[PageListener]:
    """The listener, with a certificate where it needs one, and its addresses printed."""
    token = token_of(args) or secrets.token_urlsafe(24)
    options = bound_server(args.http, _SEAT, option="--http", certificate=args.cert)
    with (
        TemporaryDirectory(prefix="kontur-rtc-") as folder,
        served(options, Path(folder), _SEAT) as (found, made),
    ):
        listener = replace(found[_SEAT], operator_token=token)
        base = base_url(listener, _SEAT)
        say(f"page {listener.url(_SEAT)}")
        say(f"whip {base}/whip\nwhep {base}/whep/{_NAME}\ntoken {token}")
        if made:
            say(f"certificate made for this run, SHA-256 {made}")
        yield listener


async def _serve(args: argparse.Namespace) -> RtcCommandReport:
    clock, sends, servers = MonotonicClock(), sends_of(args), ice_servers_of(stream_options(args))
    begin_s = time.monotonic()
    with _listening(args) as listener, closing(PartnerOutput(args, clock)) as output:
        programme = Programme(_NAME, sends=sends, want_key=lambda _: sources.want_key())
        server = RtcServer(
            listener,
            [programme] if sends else [],
            clock=clock,
            handle=output.handle,
            servers=servers,
        )
        with coded_sources(
            args, clock, send_unit=programme.send_unit, send_opus=programme.send_opus
        ) as sources:
            await server.start()
            newest = None
            async for _ in driven(args.seconds):
                output.flush()
                sources.wanted = any(peer.connected for peer in programme.peers)
                sources.handle_request(programme.requested_bps)
                for peer in server.peers:
                    newest = connection_report(peer) or newest
            await server.close()
            return RtcCommandReport(
                seconds=time.monotonic() - begin_s,
                connections=server.made,
                ice_restarts=sum(peer.restarts for peer in server.peers),
                last=newest,
                pictures=output.pictures(),
                voice=output.voice(),
                coded=dict(sources.coded),
                rate_bps=sources.rate.bps if args.video is not None else None,
                cpu_s=time.process_time(),
                failed=[*([sources.fault] if sources.fault else []), *output.finish()],
            )
