"""The options of a session's leg to a partner across the Internet, and where it is served."""

import argparse
import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace

from kontur_av.errors import ConfigError
from kontur_av.topics.session_files import session_root
from pipelines.commands.rtc_options import add_ice_arguments, ice_servers_of
from pipelines.partner.ice_servers import IceServers
from pipelines.session.option_rows import add_options
from pipelines.session.output import say
from pipelines.session.page_sockets import PageListener
from pipelines.session.served_pages import ServerWish, base_url, bound_server, served, write_private
from pipelines.session.setup.table import Setup
from pipelines.session.topology import RTC, Segment
from telepresence.private_file import read_secret

_PORT = "8290"


@dataclass(frozen=True, kw_only=True)
class RtcWish:
    """The leg as the options ask for it. token: "" for a new one. servers: of each connection."""

    server: ServerWish
    token: str
    servers: Callable[[], IceServers]


def add_rtc_arguments(parser: argparse.ArgumentParser) -> None:
    add_options(
        parser,
        f"--rtc [HOST:]PORT <?={_PORT}>  serve a partner across the Internet by WebRTC: it sees "
        f"and hears both sides, and is seen and heard at the ground (default 127.0.0.1:{_PORT}); "
        "TLS beyond loopback",
        "--rtc-token-file FILE <Path>  the partner's token (default: a new one for each session)",
    )
    add_ice_arguments(parser)


def bound_rtc(
    args: argparse.Namespace, setup: Setup, segments: tuple[Segment, ...]
) -> RtcWish | None:
    """Bind what the options ask for; None without a leg on this machine.

    ConfigError for options that cannot work, and for an address that cannot be had.
    """
    servers = ice_servers_of(args)
    if setup.rtc is None or Segment.GROUND not in segments:
        given = (args.rtc, args.rtc_token_file, args.ice_server)
        if any(one is not None for one in given):
            why = "give --rtc, too" if setup.rtc is None else "the leg is at the ground's end"
            raise ConfigError(f"--rtc-token-file and --ice-server belong to a partner: {why}")
        return None
    token = ""
    if args.rtc_token_file is not None:
        token = read_secret(args.rtc_token_file, "--rtc-token-file")
    server = bound_server(args.rtc or _PORT, RTC, "--rtc", args.page_cert)
    return RtcWish(server=server, token=token, servers=servers)


@contextmanager
def announced_rtc(
    wish: RtcWish | None, session: str, *, quiet: bool
) -> Iterator[Mapping[str, PageListener]]:
    """Make token and certificate, print the addresses, and yield the listener by process.

    They are also in `rtc.json` in the session's directory, for programs of this user.
    """
    if wish is None:
        yield {}
        return
    root = session_root(session)
    with served(wish.server, root, "rtc") as (found, made):
        listener = found[RTC]
        if wish.token:
            listener = replace(listener, operator_token=wish.token)
        told = {
            "page": listener.url(RTC),
            "base": base_url(listener, RTC),
            "token": listener.operator_token,
        }
        write_private(root / "rtc.json", json.dumps(told, indent=1) + "\n")
        if not quiet:
            lines = [f"partner {told['page']}"]
            if made:
                lines.append(f"its certificate was made for this session: {made}")
            say("\n".join(lines))
        yield {RTC: listener}
