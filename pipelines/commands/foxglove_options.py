"""The option of a session's channels for Foxglove."""

import argparse
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from socket import socket
from typing import NamedTuple

from kontur_av.topics.session_files import session_root
from pipelines.commands.common import output_that_may_fail
from pipelines.commands.page_options import parse_page, write_private
from pipelines.session.page_certificate import certificate_for
from pipelines.session.page_sockets import PageHost, PageListener, bind_pages, listeners
from pipelines.session.topology import FOXGLOVE

_PORT = "8765"


class FoxgloveWish(NamedTuple):
    """Where the channels are to be served. sockets: bound, by process."""

    host: PageHost
    sockets: Mapping[str, socket]


def add_foxglove_argument(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--foxglove",
        metavar="[HOST:]PORT",
        nargs="?",
        const=_PORT,
        help="serve the channels of a recording to Foxglove and Lichtblick "
        f"(default 127.0.0.1:{_PORT}); another host than loopback gets TLS",
    )


def bound_foxglove(args: argparse.Namespace) -> FoxgloveWish | None:
    """Bind what the option asks for; ConfigError if that cannot be."""
    if args.foxglove is None:
        return None
    host, port = parse_page(args.foxglove, "--foxglove")
    return FoxgloveWish(host, bind_pages(host, port, [FOXGLOVE]))


@contextmanager
def announced_foxglove(
    wish: FoxgloveWish | None, session: str, *, quiet: bool
) -> Iterator[Mapping[str, PageListener]]:
    """Make tokens and certificate, print the addresses, and yield the listeners by process.

    The addresses are also in `foxglove.json` in the session's directory.
    """
    if wish is None:
        yield {}
        return
    root = session_root(session)
    certificate, made = certificate_for(wish.host, None, root / "foxglove.pem")
    found = listeners(wish.sockets, wish.host, certificate and certificate.resolve())
    listener = found[FOXGLOVE]
    url = listener.url(FOXGLOVE).replace("http", "ws", 1)
    watch = url.replace(listener.operator_token, listener.viewer_token)
    write_private(root / "foxglove.json", json.dumps({"foxglove": url, "watch": watch}) + "\n")
    if not quiet:
        with output_that_may_fail():
            print(f"foxglove {url}\nto watch only: {watch}", flush=True)
            if made:
                print(f"certificate made for foxglove, SHA-256 {made}", flush=True)
    try:
        yield found
    finally:
        listener.socket.close()
