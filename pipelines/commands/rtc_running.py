"""The common part of the commands that speak WebRTC: how long they run, and what they say."""

import argparse
import asyncio
from collections.abc import AsyncIterator, Callable

from kontur_av.clock import Clock
from pipelines.commands.rtc_options import ice_servers_of, token_of
from pipelines.partner.ice_servers import IceServers
from pipelines.partner.peer import RtcConnection, RtcPeer, connection_report
from pipelines.partner.whip import Keeper
from pipelines.session.command_process import say, stopped_by_signals
from pipelines.session.option_rows import add_options

_LOOK_S = 0.2


def add_run_arguments(parser: argparse.ArgumentParser) -> None:
    add_options(parser, "--seconds", "--report")


async def driven(
    seconds: float | None, running: asyncio.Future[None] | None = None
) -> AsyncIterator[None]:
    """Yield five times a second, until the time is over, a signal comes, or `running` has ended.

    Raises what `running` raises.
    """
    loop = asyncio.get_running_loop()
    end_s = None if seconds is None else loop.time() + seconds
    with stopped_by_signals() as stopped:
        while not stopped() and (end_s is None or loop.time() < end_s):
            if running is not None and running.done():
                running.result()
                return
            yield
            await asyncio.sleep(_LOOK_S)


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
    seconds: float | None, keeper: Keeper[RtcPeer], look: Callable[[], None]
) -> RtcConnection | None:
    """Keep the connection until the command ends; figures of the newest one.

    look: called five times a second.
    """
    newest = None
    running = asyncio.create_task(keeper.run())
    async for _ in driven(seconds, running):
        look()
        if keeper.peer is not None:
            newest = connection_report(keeper.peer) or newest
    if keeper.peer is not None:
        newest = connection_report(keeper.peer) or newest
    keeper.stop()
    await running
    return newest
