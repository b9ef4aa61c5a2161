"""The options of a session's browser pages: where they are served, and with which certificate."""

import argparse
from collections.abc import Sequence
from pathlib import Path

from kontur_av.errors import ConfigError
from pipelines.session.page_certificate import check_certificate
from pipelines.session.page_sockets import bind_pages
from pipelines.session.served_pages import PAGES_PORT, PageWish, parse_page
from pipelines.session.topology import Segment

#: In the order of their ports.
_SEATS = (Segment.SPACE, Segment.GROUND)


def add_page_arguments(parser: argparse.ArgumentParser) -> None:
    either = parser.add_mutually_exclusive_group()
    either.add_argument(
        "--page",
        metavar="[HOST:]PORT",
        help=f"where the browser pages are served (default 127.0.0.1:{PAGES_PORT}, "
        "or the next free ports); TLS beyond loopback",
    )
    either.add_argument("--no-page", action="store_true", help="serve no browser pages")
    parser.add_argument("--open", action="store_true", help="open the first page in a browser")
    parser.add_argument(
        "--page-cert",
        type=Path,
        metavar="FILE",
        help="PEM file with certificate and key for the pages (default: made for the session)",
    )


def bound_pages(args: argparse.Namespace, segments: Sequence[Segment] = _SEATS) -> PageWish | None:
    """Bind what the options ask for; None without pages. segments: those that run here.

    Raises ConfigError for options that contradict each other, for an address that cannot be had,
    and for a certificate that no browser would take.
    """
    if args.no_page:
        for option, given in (
            ("--open", args.open),
            ("--page-cert", args.page_cert),
            ("--joystick page", args.joystick == "page"),
        ):
            if given:
                raise ConfigError(f"{option} needs the pages: leave --no-page out")
        return None
    host, port = parse_page(args.page)
    if args.page_cert is not None:
        check_certificate(args.page_cert)
    seats = [segment.value for segment in _SEATS if segment in segments]
    sockets = bind_pages(host, port, seats)
    return PageWish(host=host, sockets=sockets, certificate=args.page_cert, browser=bool(args.open))
