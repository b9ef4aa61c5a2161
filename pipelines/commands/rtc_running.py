"""The common part of the commands that speak WebRTC: how long they run, and what they say."""

import argparse
import asyncio
import signal
from collections.abc import AsyncIterator, Callable
from contextlib import suppress
from pathlib import Path

from kontur_av.clock import NS_PER_MS, Clock
from pipelines.commands.common import add_seconds_argument
from pipelines.commands.rtc_options import ice_servers_of, token_of
from pipelines.media.rtp_reports import Latency
from pipelines.partner.description import Kind
from pipelines.partner.ice_servers import IceServers
from pipelines.partner.peer import RtcPeer
from pipelines.partner.tally import TrackFigures
from pipelines.partner.whip import Keeper
from pipelines.session.children import ENDING
from pipelines.session.figures import Report
from pipelines.session.output import say


class ReceivedKind(Report, frozen=True, kw_only=True):
    """A picture or a voice that came: how much was decoded, and how old it was then."""

    decoded: int
    latency_ms: Latency | None


class RtcStream(Report, frozen=True, kw_only=True):
    """One stream of a connection; what the other end tells stands under `remote_`."""

    packets: int
    octets: int
    lost: int
    round_trip_ms: float | None = None
    keys_asked: int = 0
    nacks: int = 0
    repeated: int = 0
    dropped: int = 0
    rate_told_bps: int | None = None


class RtcConnection(Report, frozen=True, kw_only=True):
    """A connection; `route` is how its addresses were found: host, srflx, prflx or relay."""

    route: str | None
    ice_restarts: int
    sent: dict[str, RtcStream]
    received: dict[str, RtcStream]
    garbage: int


class RtcCommandReport(Report, frozen=True, kw_only=True):
    """The report of a command that speaks WebRTC; `failed` says what went wrong."""

    seconds: float
    connections: int
    ice_restarts: int
    last: RtcConnection | None
    pictures: ReceivedKind | None = None
    voice: ReceivedKind | None = None
    coded: dict[str, int]
    rate_bps: int | None = None
    cpu_s: float
    failed: list[str]


def connection_report(peer: RtcPeer) -> RtcConnection | None:
    """Return the figures of a connection; None before its descriptions were exchanged."""
    if peer.media is None:
        return None
    route, figures = peer.route, peer.media.figures
    return RtcConnection(
        route=None if route is None else str(route),
        ice_restarts=peer.restarts,
        sent=_streams(figures.sent),
        received=_streams(figures.received),
        garbage=figures.garbage,
    )


def _streams(figures: dict[Kind, TrackFigures]) -> dict[str, RtcStream]:
    found = {}
    for kind, one in figures.items():
        trip_ns = None if one.reception is None else one.reception.round_trip_ns
        found[str(kind)] = RtcStream(
            packets=one.packets,
            octets=one.octets,
            lost=one.lost,
            round_trip_ms=None if trip_ns is None else trip_ns / NS_PER_MS,
            keys_asked=one.keys_asked,
            nacks=one.asked,
            repeated=one.repeated,
            dropped=one.dropped,
            rate_told_bps=one.wish_bps,
        )
    return found


_LOOK_S = 0.2


def add_run_arguments(parser: argparse.ArgumentParser) -> None:
    add_seconds_argument(parser)
    parser.add_argument("--report", type=Path, metavar="FILE", help="write the report as JSON")


async def driven(
    args: argparse.Namespace, running: asyncio.Future[None] | None = None
) -> AsyncIterator[None]:
    """Yield five times a second, until the time is over, a signal comes, or `running` has ended.

    Raises what `running` raises.
    """
    loop, stop = asyncio.get_running_loop(), asyncio.Event()
    nohup = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    ending = [number for number in ENDING if not (nohup and number == signal.SIGHUP)]
    for number in ending:
        loop.add_signal_handler(number, stop.set)
    end_s = None if args.seconds is None else loop.time() + args.seconds
    try:
        while not stop.is_set() and (end_s is None or loop.time() < end_s):
            if running is not None and running.done():
                running.result()
                return
            yield
            with suppress(TimeoutError):
                async with asyncio.timeout(_LOOK_S):
                    await stop.wait()
    finally:
        for number in ending:
            loop.remove_signal_handler(number)


def keeper_of(
    args: argparse.Namespace,
    url: str,
    make_peer: Callable[[IceServers], RtcPeer],
    clock: Clock,
) -> Keeper[RtcPeer]:
    """Return a connection to a media server at `url`, as the options say. It prints its changes."""
    return Keeper(
        url,
        token=token_of(args),
        token_origins=args.token_origin,
        make_peer=make_peer,
        servers=ice_servers_of(args, may_be_named=True),
        clock=clock,
        told=say,
    )


async def keep(
    args: argparse.Namespace, keeper: Keeper[RtcPeer], look: Callable[[], None]
) -> RtcConnection | None:
    """Keep the connection until the command ends; figures of the newest one.

    look: called five times a second.
    """
    newest = None
    running = asyncio.create_task(keeper.run())
    async for _ in driven(args, running):
        look()
        if keeper.peer is not None:
            newest = connection_report(keeper.peer) or newest
    if keeper.peer is not None:
        newest = connection_report(keeper.peer) or newest
    keeper.stop()
    await running
    return newest
