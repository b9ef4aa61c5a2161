"""Where a session's browser pages are served, and what is said of it. A shell."""

import json
import re
import subprocess
import sys
import webbrowser
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from html import escape
from pathlib import Path
from socket import socket

from kontur_av.errors import ConfigError
from kontur_av.hosts import resolve
from kontur_av.topics.session_files import session_root
from pipelines.session.access import Role
from pipelines.session.command_process import say
from pipelines.session.option_rows import refuse_options
from pipelines.session.options import PAGE_PORT, StreamOptions
from pipelines.session.page_sockets import (
    PageHost,
    PageListener,
    bind_pages,
    certificate_for,
    check_certificate,
    listeners,
)
from pipelines.session.setup.segments import Segment
from pipelines.session.topology.table import SessionOptions
from pipelines.session.topology.topics import PAGES

#: The ground's page takes a later port than the operator's.
_LAST_PORT = 65_534
#: By the name that is printed: end, page and role of each of the mission's people.
_PEOPLE = {
    "panel": ("space", "panel", Role.COSMONAUT),
    "k2cp": ("space", "k2cp", Role.COSMONAUT),
    "top": ("ground", "top", Role.EXPERIMENTER),
    "k2sv": ("ground", "k2sv", Role.SUPERVISOR),
    "systems": ("ground", "systems", Role.SYSTEMS),
}
#: Pages that show nothing in a session without tasks.
_OF_TASKS = ("panel", "top")
#: In the order of their ports.
_SEATS = (Segment.SPACE, Segment.GROUND)


@dataclass(frozen=True, kw_only=True)
class ServerOptions:
    """A server as an option asks for it. sockets: bound, by the names of its listeners.

    certificate: the user's own.
    """

    host: PageHost
    sockets: Mapping[str, socket]
    certificate: Path | None = None


def parse_page(text: str | None, option: str = "--page") -> tuple[PageHost, int]:
    """Return host and first port of `option`; ConfigError if `text` is not [HOST:]PORT."""
    if text is None:
        return PageHost(), int(PAGE_PORT)
    match = re.fullmatch(r"(?:(\[[^\]]+\]|[^:]+):)?(\d{1,5})", text)
    if match is None or not 1 <= int(match[2]) <= _LAST_PORT:
        raise ConfigError(
            f"{option} {text!r}: write [HOST:]PORT with a port from 1 to {_LAST_PORT}"
        )
    if match[1] is None:
        return PageHost(), int(match[2])
    host = match[1].strip("[]")
    return PageHost(host=host, address=resolve(host, text, option)), int(match[2])


def bound_server(
    text: str | None, *names: str, option: str = "--page", certificate: Path | None = None
) -> ServerOptions:
    """Bind these listeners from `text` on, as of `parse_page`; ConfigError if that cannot be."""
    host, port = parse_page(text, option)
    if certificate is not None:
        check_certificate(certificate)
    return ServerOptions(host=host, sockets=bind_pages(host, port, names), certificate=certificate)


@contextmanager
def served(
    options: ServerOptions, root: Path, name: str, *, trainer: bool = False
) -> Iterator[tuple[Mapping[str, PageListener], str]]:
    """Yield the listeners, and the SHA-256 of a certificate that was made for them, or "".

    root: where such a certificate is kept, as `name`.pem. trainer: one has a page, too.
    """
    certificate, made = certificate_for(options.host, options.certificate, root / f"{name}.pem")
    pem = certificate and certificate.resolve()
    found = listeners(options.sockets, options.host, pem, trainer=trainer)
    try:
        yield found, made
    finally:
        for listener in found.values():
            listener.socket.close()


@contextmanager
def announced_pages(
    options: ServerOptions | None, session: str, args: StreamOptions, table: SessionOptions
) -> Iterator[Mapping[str, PageListener]]:
    """Make tokens and certificate, print one address, and yield the listeners by process.

    It leads to every page. Each page's own address is in `pages.json` in the session's directory,
    for programs of this user. table: what the session has.
    """
    if options is None:
        yield {}
        return
    root = session_root(session)
    with served(options, root, "page", trainer=table.trainer) as (seats, made):
        urls = {seat: listener.url(seat) for seat, listener in seats.items()}
        people = {
            name: seats[seat].url(page, role=role.value)
            for name, (seat, page, role) in _PEOPLE.items()
            if seat in seats and (table.tasks or page not in _OF_TASKS)
        }
        first = next(iter(seats.values()))
        if table.trainer:
            people["trainer"] = first.url("trainer", role=Role.TRAINER.value)
        address, watch = first.url(""), first.url("", role=Role.VIEWER.value)
        kept = {"pages": address, **urls, **people, "viewer_token": first.viewer_token}
        lines = [f"pages: {address}", f"to watch only: {watch}"]
        announce(root / "pages.json", kept, lines, made, quiet=args.quiet)
        if args.open:
            _open_in_browser(address, root)
        yield {PAGES[Segment(name)]: listener for name, listener in seats.items()}


def announce(
    file: Path, kept: Mapping[str, str], lines: Sequence[str], made: str, *, quiet: bool
) -> None:
    """Keep addresses for programs of this user, and print lines. made: as of `served`."""
    write_private(file, json.dumps(kept, indent=1) + "\n")
    certificate = [f"certificate made for this session, SHA-256 {made}"] * bool(made)
    if not quiet:
        say("\n".join([*lines, *certificate]))


def _open_in_browser(address: str, root: Path) -> None:
    """Open an address, or say in one line why not.

    The browser is given a file that leads there, because other users of this machine see the
    arguments of a program, but not this file with its token.
    """
    try:
        webbrowser.get()
    except webbrowser.Error:
        print("kontur-av: --open: no browser was found; open the address", file=sys.stderr)
        return
    leads = root / "open.html"
    to = escape(address)
    write_private(
        leads,
        '<!doctype html><meta charset="utf-8"><title>kontur-av</title>'
        f'<meta http-equiv="refresh" content="0;url={to}"><a href="{to}">kontur-av</a>\n',
    )
    # Some browsers keep their caller waiting, others would take over the terminal.
    subprocess.Popen(
        [sys.executable, "-m", "webbrowser", leads.as_uri()],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


def base_url(listener: PageListener, seat: str) -> str:
    """Return the address of a page up to its port."""
    return listener.url(seat).partition(f"/{seat}?")[0]


def write_private(path: Path, text: str) -> None:
    """Write a new file that only its owner may read. It appears with all of its text."""
    unready = path.with_suffix(".new")
    unready.touch(0o600, exist_ok=False)
    unready.write_text(text)
    unready.rename(path)


def bound_pages(args: StreamOptions, segments: Sequence[Segment] = _SEATS) -> ServerOptions | None:
    """Bind what the options ask for; None without pages. segments: those that run here.

    Raises ConfigError for options that contradict each other, for an address that cannot be had,
    and for a certificate that no browser would take.
    """
    if args.page is False:
        why = " needs the pages: leave --no-page out"
        refuse_options(args, why, "open", "page_cert")
        if args.joystick == "page":
            raise ConfigError(f"--joystick page{why}")
        return None
    seats = [segment.value for segment in _SEATS if segment in segments]
    text = args.page if isinstance(args.page, str) else None
    return bound_server(text, *seats, certificate=args.page_cert)
