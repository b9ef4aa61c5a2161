"""Pages listen on the next free ports, and know the names that a browser may ask for."""

import contextlib
import socket

import pytest

from kontur_av.errors import ConfigError
from pipelines.session import page_sockets
from pipelines.session.page_sockets import PageHost, bind_pages, listeners

SEATS = ("space", "ground")
LOOPBACK = PageHost()


def taken():
    """A listening socket, below a port that is likely to be free."""
    held = socket.create_server(("127.0.0.1", 0))
    return held, held.getsockname()[1]


def close(sockets):
    for listener in sockets.values():
        listener.close()


def test_a_busy_port_gives_way_to_the_next():
    with contextlib.closing(taken()[0]) as held:
        port = held.getsockname()[1]
        if port > 65_000:
            pytest.skip("the system gave one of the last ports")
        sockets = bind_pages(LOOPBACK, port, SEATS)
        space, ground = (sockets[seat].getsockname()[1] for seat in SEATS)
        # A second session takes ports behind those of the first.
        others = bind_pages(LOOPBACK, port, SEATS)
        assert port < space < ground < others["space"].getsockname()[1]
        # A browser may connect before the process serves it.
        socket.create_connection(("127.0.0.1", space)).close()
        close(sockets)
        close(others)


def test_no_free_port_and_foreign_addresses_are_named(monkeypatch):
    monkeypatch.setattr(page_sockets, "_MOST_PORTS", 1)
    held, port = taken()
    busy = f"TCP ports {port} to {port} are busy"
    with contextlib.closing(held), pytest.raises(ConfigError, match=busy):
        bind_pages(LOOPBACK, port, SEATS)
    with pytest.raises(ConfigError, match="no address of this machine"):
        bind_pages(PageHost(host="far", address="192.0.2.1"), 8270, SEATS)


def test_both_pages_have_the_same_two_tokens():
    sockets = {seat: socket.socket() for seat in SEATS}
    pages = listeners(sockets, LOOPBACK, None)
    space, ground = pages["space"], pages["ground"]
    assert space.operator_token == ground.operator_token != space.viewer_token
    assert len(space.operator_token) >= 32
    assert space.url("space").startswith("http://127.0.0.1:")
    assert space.operator_token not in repr(space) and space.viewer_token not in repr(space)
    # The owner may hand out every role, and an end takes those of its own people.
    assert {*space.people} == {"cosmonaut", "experimenter", "supervisor", "systems"}
    assert space.people == ground.people and not any(map(repr(space).count, space.people.values()))
    assert {*space.role_tokens} == {"cosmonaut"} and space.ports == ground.ports
    again = listeners(sockets, LOOPBACK, None)
    assert again["space"].operator_token != space.operator_token
    close(sockets)


def test_a_browser_may_ask_only_for_names_of_the_bound_address():
    assert LOOPBACK.names() == ("127.0.0.1", "localhost")
    assert PageHost(host="Lab.Example", address="192.0.2.7").names() == ("lab.example", "192.0.2.7")
    assert (
        PageHost(host="bücher.example", address="192.0.2.7").names()[0] == "xn--bcher-kva.example"
    )
    own_name = PageHost(host="lab", address="127.0.1.1")
    assert own_name.names() == ("127.0.1.1", "lab", "localhost")
    assert PageHost(host="::1", address="::1").names() == ("::1", "localhost")
    every = PageHost(host="0.0.0.0", address="0.0.0.0").names()
    assert {"127.0.0.1", "localhost", socket.gethostname().lower()} <= set(every)
    assert "0.0.0.0" not in every


def test_only_loopback_needs_no_tls():
    hosts = {
        "127.0.0.1": True,
        "127.3.2.1": True,
        "::1": True,
        "0.0.0.0": False,
        "192.0.2.7": False,
    }
    assert {at: PageHost(host=at, address=at).is_loopback for at in hosts} == hosts
