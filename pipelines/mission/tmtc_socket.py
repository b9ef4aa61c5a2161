"""The Unix datagram socket on which processes of a segment ask its TM/TC end.

It is in the session's directory, which only its user may enter.
"""

import os
import socket
from pathlib import Path

from kontur_av.topics.session_files import session_root
from pipelines.mission.tmtc_messages import MAX_REQUEST_OCTETS, TmtcRequest, pack_request
from pipelines.session.setup.segments import Segment


def tmtc_socket_name(segment: Segment) -> str:
    """Return the name of the socket in the session's directory."""
    return f"tmtc.{segment.value}"


def tmtc_path(session: str, segment: Segment) -> Path:
    """Return the path of the socket of a session."""
    return session_root(session) / tmtc_socket_name(segment)


def send_to_tmtc(session: str, segment: Segment, request: TmtcRequest) -> bool:
    """Send a request to the TM/TC end of a segment, without waiting.

    Returns False if nobody takes it now; try again later. ConfigError for a request that is too
    long. What becomes of it comes on the topic `TMTC_TOPICS[segment]`.
    """
    octets = pack_request(request)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as link:
        link.setblocking(False)
        try:
            link.sendto(octets, os.fspath(tmtc_path(session, segment)))
        except OSError:
            return False
    return True


class TmtcSocket:
    """The listening end; the directory of the session exists. socket: what to wait for."""

    def __init__(self, session: str, segment: Segment) -> None:
        self._path = tmtc_path(session, segment)
        self._path.unlink(missing_ok=True)  # of a process that was killed
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.setblocking(False)
        self.socket.bind(os.fspath(self._path))

    def receive(self) -> bytes | None:
        """Return the next request, or None. A longer one than allowed has one octet too many."""
        try:
            return self.socket.recv(MAX_REQUEST_OCTETS + 1)
        except BlockingIOError:
            return None

    def close(self) -> None:
        """Take no more requests."""
        self._path.unlink(missing_ok=True)
        self.socket.close()
