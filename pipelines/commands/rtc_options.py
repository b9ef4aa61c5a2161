"""Options of the commands that speak WebRTC: tokens, STUN and TURN servers, rates."""

import argparse
import re
import time
from collections.abc import Callable

from kontur_av.errors import ConfigError
from pipelines.partner.ice_servers import IceServer, IceServers, timed_credentials
from pipelines.session.option_rows import refuse_options
from pipelines.session.options import StreamOptions
from telepresence.private_file import read_secret

#: The options of STUN and TURN servers.
ICE = ("ice_server", "turn_secret_file", "turn_user", "turn_password_file", "ice_relay_only")
#: What an HTTP header can carry (RFC 6750 section 2.1).
_TOKEN = re.compile(r"[A-Za-z0-9._~+/=-]{1,4096}")


def token_of(args: argparse.Namespace) -> str:
    """Return the token; "" for none. ConfigError for one that cannot be sent."""
    token: str = args.token or ""
    if token and args.token_file is not None:
        raise ConfigError("--token and --token-file: give one of them")
    if args.token_file is not None:
        token = read_secret(args.token_file, "--token-file")
    if token and _TOKEN.fullmatch(token) is None:
        raise ConfigError("the token has characters that no bearer token may have")
    return token


def ice_servers_of(args: StreamOptions, *, may_be_named: bool = False) -> Callable[[], IceServers]:
    """Return what makes the servers of a new connection, with fresh credentials.

    may_be_named: a media server may name them later (RFC 9725 section 4.6). ConfigError for options
    that cannot work together.
    """
    url, secret_file, user = args.ice_server, args.turn_secret_file, args.turn_user
    if url is None:
        why = " belongs to a server: give --ice-server turn:HOST, too"
        refuse_options(args, why, "turn_secret_file", "turn_user", "turn_password_file")
        servers = IceServers(relay_only=args.ice_relay_only)
        if not may_be_named:
            servers.check()
        return lambda: servers
    password_file = args.turn_password_file
    if (user is None) != (password_file is None):
        raise ConfigError("give both --turn-user and --turn-password-file, or neither")
    secret = "" if secret_file is None else read_secret(secret_file, "--turn-secret-file")
    password = "" if password_file is None else read_secret(password_file, "--turn-password-file")

    def make() -> IceServers:
        username, credential = user or "", password
        if secret:
            username, credential = timed_credentials(secret, name="kontur", now_s=int(time.time()))
        server = IceServer(url=url, username=username, credential=credential)
        return IceServers(servers=(server,), relay_only=args.ice_relay_only)

    make().check()
    return make
