"""Invariant: whatever a supervisor receives as a message, it counts it and continues.

Nothing raises. Octets that no end with this configuration sent never make the peer count as
connected, or fit for delivery. The rate of messages stays bounded. A matching peer is found again
as soon as it is heard.
"""

from random import Random

from common import first_seed, repeats
from hypothesis import given
from hypothesis import strategies as st
from link_supervision_pair import GROUND, MS, SPACE

from telepresence.link.clock_exchange import ClockExchange
from telepresence.link.supervision.message import LinkState
from telepresence.link.supervision.record import ContextsHeld
from telepresence.link.supervision.supervisor import Encounter, Supervisor

MESSAGES = repeats(10_000)


def begun(*, master):
    supervisor = Supervisor(
        master=master, configuration=GROUND if master else SPACE, life=2 - master, now_ns=0
    )
    supervisor.handle_local_check(None, 0)
    return supervisor


def drain(supervisor):
    return list(iter(supervisor.next_event, None))


def talk(one, other, since, slots):
    """Let both ends hear each other, with data, for this many slots."""
    for slot in range(since, since + slots):
        for sender, receiver in ((one, other), (other, one)):
            message = sender.poll_transmit(slot * MS)
            receiver.handle_frame(slot * MS)
            if message is not None:
                receiver.handle_message(message, slot * MS)
            if receiver.delivering:
                receiver.handle_application(slot * MS)
            drain(receiver)
    assert one.state is other.state is LinkState.CONNECTED


def test_whatever_strangers_say_a_live_connection_stays():
    """Mutated messages of the peer, of another life, and random octets, in long streams."""
    random = Random(first_seed(6))
    victim, peer = begun(master=True), begun(master=False)
    talk(victim, peer, 0, 3000)
    stranger = Supervisor(master=False, configuration=SPACE, life=777, now_ns=0, secret=9)
    stranger.handle_local_check(None, 0)
    sent, seen = 0, [bytes(12)]
    for slot in range(3000, 3000 + MESSAGES):
        now_ns = slot * MS
        for sender, receiver in ((victim, peer), (peer, victim)):
            message = sender.poll_transmit(now_ns)
            receiver.handle_frame(now_ns)
            receiver.handle_application(now_ns)
            if message is not None:
                sent += sender is victim
                seen.append(message)
                receiver.handle_message(message, now_ns)
        told = random.choice(
            (stranger.poll_transmit(now_ns), None, random.choice(seen), random.randbytes(12))
        )
        if told is not None and random.random() < 0.5:
            octets = bytearray(told)
            octets[random.randrange(12)] ^= 1 << random.randrange(8)
            told = bytes(octets)
        frames = random.choice((0, 1, 50, 5000))
        found = victim.handle_stranger(told, now_ns, frames=frames, lasts_ns=frames * MS)
        assert found is Encounter.IGNORE
        assert not [event for event in drain(victim) if not isinstance(event, ContextsHeld)]
        drain(peer)
        assert victim.state is LinkState.CONNECTED
    # At most an answer each 20 ms, and the regular messages.
    assert sent <= MESSAGES // 20 + MESSAGES // 200
    counts = victim.report(0).counts
    assert counts["messages_malformed"] > 0 < counts["messages_mismatched"]
    assert counts["signals_lost"] == counts["peer_restarts"] == 0


@given(st.lists(st.tuples(st.binary(min_size=8, max_size=8), st.integers(0, 10**9)), max_size=60))
def test_any_clocks_of_the_peer_are_taken_or_begun_anew(told):
    exchange = ClockExchange(version=2, master=True, life=1, told_offset_ns=0, now_ns=0)
    exchange.handle_peer(7, 0)
    now_ns = 0
    for rest, later_ns in told:
        now_ns += later_ns
        exchange.poll_transmit(now_ns, now_ns)
        assert exchange.handle_message(bytes.fromhex("25000007") + rest, now_ns, heard=True)
        found = exchange.estimate(now_ns)
        assert found is None or found.error_ns > 0
    figures = exchange.report(now_ns)
    assert figures.messages_received == len(told)
    assert figures.restarts <= len(told) + 1
