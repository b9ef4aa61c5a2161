"""An FTP server for the copies of the joystick's software: updates up, log files down.

FTP has no protection of its own, so the server listens on loopback unless told otherwise.
"""

import secrets
from collections.abc import Callable
from pathlib import Path

from kontur_av.errors import ConfigError

USER = "kontur"
_POLL_S = 0.2
#: What may be done: change folder, list, read; append, delete, rename, make folders, store, chmod.
_RIGHTS = "elradfmwM"


def serve_ftp(
    folder: Path, address: tuple[str, int], say: Callable[[str], None], stopped: Callable[[], bool]
) -> None:
    """Serve the files below a folder to the user `kontur` until `stopped`."""
    try:
        from pyftpdlib.authorizers import DummyAuthorizer
        from pyftpdlib.handlers import FTPHandler
        from pyftpdlib.servers import FTPServer
    except ImportError:
        raise ConfigError(
            "the FTP server needs pyftpdlib: pip install 'kontur-av[upkeep]'"
        ) from None
    if not folder.is_dir():
        raise ConfigError(f"{folder} is no folder: `kontur-av apploader fill` makes one")
    password = secrets.token_urlsafe(12)
    authorizer = DummyAuthorizer()
    authorizer.add_user(USER, password, str(folder), perm=_RIGHTS)
    handler = type("Handler", (FTPHandler,), {"authorizer": authorizer, "banner": "kontur-av"})
    try:
        server = FTPServer(address, handler)
    except OSError as error:
        raise ConfigError(f"{address[0]}:{address[1]} cannot be used: {error.strerror}") from None
    server.max_cons, server.max_cons_per_ip = 16, 8
    host, port = server.address
    try:
        say(f"ftp://{USER}:{password}@{host}:{port}/")
        while not stopped():
            server.serve_forever(timeout=_POLL_S, blocking=False, handle_exit=False)
    finally:
        server.close_all()
