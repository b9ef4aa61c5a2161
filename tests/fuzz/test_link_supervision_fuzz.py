"""Invariant: whatever a supervisor receives as a message, it counts it and continues.

Nothing raises. Octets that no end with this configuration sent never make the peer count as
connected, or fit for delivery. The rate of messages stays bounded. A matching peer is found again
as soon as it is heard.
"""

import os
from random import Random

from hypothesis import given
from hypothesis import strategies as st

from telepresence.link.clock_exchange import ClockExchange
from telepresence.link.flows import tmtc_flow, video_flow
from telepresence.link.profile import DOWNLINK, UPLINK
from telepresence.link.supervision.message import Configuration, LinkState
from telepresence.link.supervision.record import ContextsHeld, StateChanged
from telepresence.link.supervision.supervisor import Encounter, Supervisor

MS = 1_000_000
GROUND = Configuration(
    transmit=UPLINK,
    transmit_flows=[tmtc_flow("tc"), video_flow("video")],
    receive=DOWNLINK,
    receive_flows=[tmtc_flow("tm")],
)
SPACE = Configuration(
    transmit=DOWNLINK,
    transmit_flows=[tmtc_flow("tm")],
    receive=UPLINK,
    receive_flows=[tmtc_flow("tc"), video_flow("video")],
)
MESSAGES = int(os.environ.get("KONTUR_FUZZ_MESSAGES", "20000"))


def begun(*, master):
    supervisor = Supervisor(
        master=master, configuration=GROUND if master else SPACE, life=2 - master, now_ns=0
    )
    supervisor.handle_local_check(None, 0)
    return supervisor


def drain(supervisor):
    events = []
    while event := supervisor.next_event():
        events.append(event)
    return events


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


@given(st.lists(st.binary(max_size=40), max_size=40), st.booleans())
def test_octets_of_any_length(datagrams, master):
    supervisor = begun(master=master)
    for slot, data in enumerate(datagrams):
        supervisor.handle_message(data, slot * MS)
        supervisor.poll_transmit(slot * MS)
    counts = supervisor.report(len(datagrams) * MS).counts
    assert counts["messages_malformed"] + counts["messages_received"] == len(datagrams)
    drain(supervisor)
    talk(supervisor, begun(master=not master), len(datagrams), 100)


def test_mutated_messages():
    random = Random(5)
    victim, peer = begun(master=True), begun(master=False)
    talk(victim, peer, 0, 100)
    sent = 0
    for slot in range(100, 100 + MESSAGES):
        now_ns = slot * MS
        peer.handle_frame(now_ns)
        message = bytearray(peer.poll_transmit(now_ns) or random.randbytes(12))
        for _ in range(random.choice((1, 1, 2, 12))):
            message[random.randrange(12)] ^= 1 << random.randrange(8)
        victim.handle_message(bytes(message), now_ns)
        assert sum(isinstance(event, StateChanged) for event in drain(victim)) <= 1
        sent += victim.poll_transmit(now_ns) is not None
        # No application data comes, so a link that a message connected may be reset at once.
        assert sum(isinstance(event, StateChanged) for event in drain(victim)) <= 1
        drain(peer)
    assert sent <= MESSAGES // 10 + 1
    counts = victim.report(0).counts
    assert counts["messages_malformed"] + counts["messages_mismatched"] > MESSAGES // 2
    talk(victim, peer, 100 + MESSAGES, 4000)


def test_whatever_strangers_say_a_live_connection_stays():
    """Mutated messages of the peer, of another life, and random octets, in long streams."""
    random = Random(6)
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
