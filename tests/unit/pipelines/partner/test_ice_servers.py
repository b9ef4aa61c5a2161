"""STUN and TURN servers: credentials that end by themselves, and what HTTP says of servers."""

import base64
import hashlib
import hmac

import pytest

from kontur_av.errors import ConfigError
from pipelines.partner.ice_servers import IceServer, IceServers, servers_of_links, timed_credentials

STUN = IceServer(url="stun:stun.example")
TURN = IceServer(url="turn:turn.example:3478?transport=tcp", username="u", credential="p+/=")


def test_credentials_end_by_themselves_and_servers_go_through_a_link_header():
    username, credential = timed_credentials("a secret word", name="kontur", now_s=1_000_000_000)
    assert username == "1000003600:kontur"
    code = hmac.new(b"a secret word", username.encode(), hashlib.sha1).digest()
    assert base64.b64decode(credential) == code
    with pytest.raises(ConfigError, match="too short"):
        timed_credentials("short", name="kontur", now_s=0)
    with pytest.raises(ConfigError, match="credentials"):
        IceServer(url="turn:turn.example")
    with pytest.raises(ConfigError, match="relay-only"):
        IceServers(servers=(STUN,), relay_only=True).check()
    IceServers(servers=(TURN,), relay_only=True).check()
    # Nonsense in one: tests/fuzz/test_strangers_fuzz.py.
    servers = (STUN, TURN)
    links = IceServers(servers=servers).link_headers()
    assert servers_of_links(links) == servers
    # Several in one line, other relations in between.
    assert servers_of_links(['<https://x/>; rel="next", ' + ", ".join(links)]) == servers

    for url in ("http://x", "turn:", "turn:a b", "stun:x?transport=sctp"):
        with pytest.raises(ConfigError, match="--ice-server"):
            IceServer(url=url, username="u", credential="p")
