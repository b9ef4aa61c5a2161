"""TLS in memory: a flight is read one record a step, so that no step takes as long as all of it."""

from telepresence.link.protection.agreement import Agreement
from telepresence.link.protection.identity import MachineKey

CLIENT, SERVER, OTHER = sorted(
    (MachineKey.from_seed(bytes([n]) * 32) for n in (1, 2, 3)), key=lambda key: key.identity.digest
)


def begin(expected=SERVER):
    """Both ends' runs, and the server's flight."""
    client, server = Agreement(CLIENT, expected.identity), Agreement(SERVER, CLIENT.identity)
    ends = client.begin(), server.begin()
    ends[1].add(ends[0].step())
    return *ends, ends[1].step()


def read(run):
    """Read all that waits; return the number of steps, and what the peer is to be sent."""
    steps, written = 0, b""
    while run.waits:
        before = run.unread
        written += run.step()
        steps += 1
        assert run.unread < before
    return steps, written


def test_both_ends_agree_whatever_the_pieces_in_which_a_flight_comes():
    client, server, flight = begin()
    for octet in flight[:-1]:
        client.add(bytes([octet]))
        client.step()
        assert not client.complete
    client.add(flight[-1:])
    written = client.step()
    assert client.complete
    server.add(written)
    read(server)
    assert server.complete
    assert client.keys().send == server.keys().receive
    assert server.keys().send == client.keys().receive


def test_a_step_reads_one_record():
    client, server, flight = begin()
    client.add(flight)
    assert client.unread == len(flight)
    steps, written = read(client)
    assert client.complete
    server.add(written)
    # Certificate, its proof and the end of a flight are records of their own.
    assert steps >= 4
    assert read(server)[0] >= 3
    assert server.complete


def test_half_a_record_waits_for_its_rest_and_no_record_at_all_is_refused():
    client, _, flight = begin()
    client.add(flight[:100])
    assert (client.waits, client.unread) == (False, 0)
    client.add(b"\xff" * 5000)
    read(client)
    assert client.failed
    assert not client.waits


def test_a_peer_with_another_key_is_refused():
    client, _, flight = begin(expected=OTHER)
    client.add(flight)
    read(client)
    assert client.failed and not client.complete
