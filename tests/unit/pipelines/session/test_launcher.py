"""Two sessions never share ports."""

import os
import socket
from dataclasses import replace

import pytest

from kontur_av.errors import ConfigError
from pipelines.session.launcher import hold_ports
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.session.setup.table import PORTS
from pipelines.table import topology_of


@pytest.fixture
def session():
    """A setup whose ports are free at present."""
    # Not those that the same tests take in another worker.
    worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0")[2:])
    for base in range(31_500 - 2_000 * (worker % 4), 24_000, -PORTS):
        candidate = topology_of(replace(BUILT_IN["taskboard"], base_port=base))
        try:
            hold_ports(candidate).close()
        except ConfigError:
            continue
        return candidate
    return pytest.skip("no block of free UDP ports")


def test_a_session_is_refused_whichever_port_is_busy_and_keeps_none(session):
    # The first session has bound only the launcher's port so far.
    with hold_ports(session), pytest.raises(ConfigError, match=r"busy.*--base-port"):
        hold_ports(session)
    for offset in (0, 5, 17, 38):
        port = session.ports[offset]
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
            udp.bind(("127.0.0.1", port))
            with pytest.raises(ConfigError, match=f"UDP port {port} is busy"):
                hold_ports(session)
        hold_ports(session).close()
