"""Each part of supervision by itself: messages, pacing, negotiation, application link, record."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from link_supervision_pair import DOWN, GROUND, SPACE, UP

from kontur_av.errors import ConfigError
from telepresence.link.profile import DOWNLINK, UPLINK
from telepresence.link.supervision.local_check import LocalCheck
from telepresence.link.supervision.message import (
    LinkState,
    MessageKind,
    MessagePacing,
    SupervisionMessage,
    SupervisionTiming,
    message_version,
    pack_message,
    parse_message,
)
from telepresence.link.supervision.negotiation import MessageVerdict, Negotiation
from telepresence.link.supervision.record import SupervisionRecord
from telepresence.link.supervision.supervisor import ApplicationWatch

MS, S = 1_000_000, 1_000_000_000
TIMING = SupervisionTiming()
bits, octets = st.booleans(), st.integers(0, 255)
words, longs = st.integers(0, 65535), st.integers(0, (1 << 24) - 1)

MESSAGES = st.builds(
    SupervisionMessage,
    st.integers(1, 15),
    st.sampled_from([kind for kind in MessageKind if kind is not MessageKind.CLOCK]),
    st.sampled_from(LinkState),
    *(bits, bits, bits, bits, bits, st.integers(1, 65535), words, words),
    st.tuples(octets, octets, octets, octets),
    st.tuples(words, words),
    *(longs, longs),
)


def told(message):
    """What its kind tells of a message."""
    rates = message.kind in (MessageKind.CONFIGURE, MessageKind.REJECT)
    if message.kind is MessageKind.HELLO:
        return message._replace(heard=0, contexts=(0, 0, 0, 0), rates_kbps=(0, 0))
    none = {
        "number": 0,
        "echo": 0,
        "contexts" if rates else "rates_kbps": (0,) * (4 - 2 * (not rates)),
    }
    return message._replace(**none)


@given(MESSAGES)
def test_a_message_is_read_as_it_was_written(message):
    data = pack_message(message)
    wrong_side = MessageKind.CONFIRM if message.master else MessageKind.CONFIGURE
    expected = None if message.kind is wrong_side else told(message)
    assert len(data) == 12 and parse_message(data) == expected
    assert message_version(data) == message.version
    for bad in (data[:-1], data + b"\0", b""):
        assert parse_message(bad) is None and message_version(bad) == 0


def message(**changes):
    table = {
        "version": 3,
        "kind": MessageKind.ALIVE,
        "state": LinkState.APPROVE,
        "master": False,
        "signal": True,
        "application": False,
        "fresh": True,
        "sending": False,
        "life": 0x0102,
        "heard": 0x0304,
        "digest": 0x0506,
        "contexts": (7, 8, 9, 10),
    }
    return SupervisionMessage(**{**table, **changes})


def test_bits_are_where_the_table_says():
    assert pack_message(message()) == bytes.fromhex("30 6a 0102 0304 0506 0708090a")
    flags = {"master": 0x10, "signal": 8, "application": 4, "fresh": 2, "sending": 1}
    for name, flag in flags.items():
        one = message(**{**dict.fromkeys(flags, False), name: True}, state=LinkState.REFUSED)
        assert pack_message(one)[1] == 0xA0 | flag
    configure = message(
        kind=MessageKind.CONFIGURE, master=True, contexts=(0,) * 4, rates_kbps=(256, 4000)
    )
    assert pack_message(configure) == bytes.fromhex("31 7a 0102 0304 0506 01000fa0")
    hello = message(kind=MessageKind.HELLO, heard=0, number=0xABCDEF, echo=0x123456)
    assert pack_message(hello) == bytes.fromhex("34 6a 0102 0506 abcdef 123456")


def test_what_no_end_can_have_sent_is_refused():
    good = pack_message(message())
    # Version 0, a kind beyond HELLO, a state beyond REFUSED, no life.
    for at, octet in ((0, 0x00), (0, 0x35), (0, 0x3F), (1, 0xCA)):
        assert parse_message(good[:at] + bytes([octet]) + good[at + 1 :]) is None
    assert parse_message(good[:2] + b"\0\0" + good[4:]) is None
    assert parse_message(good) == message()


def test_messages_come_at_once_on_a_change_then_fast_then_slowly():
    """10 ms apart at least; 20 ms for 2 s; then 0.5 s, or 50 ms to a peer that may not hear."""
    pacing = MessagePacing(TIMING, 0)
    assert (pacing.due_ns, pacing.earliest_ns) == (0, 0)

    def due(now_ms, content=(1,), rest=(), *, heard=True, settled=False):
        pacing.handle_content(content, rest, now_ms * MS, heard=heard, settled=settled)
        return pacing.due_ns // MS

    assert due(0) <= 0
    pacing.handle_sent((1,), (), 0)
    assert pacing.earliest_ns == 10 * MS
    assert due(1) == due(1999) == 20
    assert due(2000) == 500 and due(2000, heard=False) == 50
    assert due(1, settled=True) == 500
    # The contexts alone are told fast, a new content at once.
    assert due(1, rest=(5,), settled=True) == 20 and due(1, content=(2,), settled=True) == 10
    pacing.handle_sent((2,), (5,), 3000 * MS)
    assert due(3001, content=(2,), rest=(5,)) == 3500
    # The 2 s count from the change, not from its message.
    assert due(3002, content=(3,), rest=(5,)) == 3010
    pacing.handle_sent((3,), (5,), 3010 * MS)
    assert due(5001, content=(3,), rest=(5,)) == 3030
    assert due(5002, content=(3,), rest=(5,)) == 3510
    # Another message keeps its distance, too.
    pacing.handle_extra(3505 * MS)
    assert due(5003, content=(3,), rest=(5,)) == 3515


@pytest.mark.parametrize("field", list(vars(TIMING)))
def test_each_wait_is_positive(field):
    for value in (0, -1):
        with pytest.raises(ConfigError, match=f"supervision {field} is {value}: it must be posi"):
            replace(TIMING, **{field: value})


def test_waits_between_messages_rise():
    equal = SupervisionTiming(spacing_ns=5, fast_ns=5, search_ns=5, slow_ns=5, round_trip_ns=7)
    assert equal.answer_ns == 28
    for field, value in (("spacing_ns", 6), ("fast_ns", 6), ("search_ns", 6)):
        with pytest.raises(ConfigError, match="must rise in this order"):
            replace(equal, **{field: value})


def test_both_ends_digest_the_same_text():
    """CRC-16/CCITT of a line for each profile and flow, the master's way out first."""
    assert GROUND.text(master=True) == SPACE.text(master=False) != SPACE.text(master=True)
    assert GROUND.digest(master=True) == SPACE.digest(master=False)
    first, *rest = GROUND.text(master=True).splitlines()
    assert first == "32 12 1000000 75 0 1" and len(rest) == len(UP) + len(DOWN) + 1
    assert GROUND.rates_kbps() == (256, 4000) and SPACE.rates_kbps() == (4000, 256)
    fast = replace(DOWNLINK, slot_ns=10_000)
    assert replace(GROUND, receive=fast).rates_kbps() == (256, 65535)
    for version in (1, 15):
        assert replace(GROUND, version=version).version == version
    for version in (0, 16):
        with pytest.raises(ConfigError, match="must be from 1 to 15"):
            replace(GROUND, version=version)
    for change in ({"scid": 1}, {"vcid": 3}, {"insert_octets": 11}, {"slot_ns": 5}):
        other = replace(GROUND, transmit=replace(UPLINK, **change))
        assert other.digest(master=True) != GROUND.digest(master=True)


def negotiation(*, master=True):
    configuration = GROUND if master else SPACE
    return Negotiation(master=master, configuration=configuration, life=9, timing=TIMING, now_ns=0)


def from_peer(of, **changes):
    """Octets of a matching peer of this negotiation."""
    table = {"version": of.version, "master": changes.pop("master", False), "digest": of.digest}
    return pack_message(message(**{**table, "heard": 9, "life": 5, **changes}))


def test_a_peers_supervision_is_dead_after_silence_since_its_last_message():
    one = negotiation()
    assert one.timeout(100 * S) is None
    alive = from_peer(one, state=LinkState.CONNECTED)
    assert one.handle_message(alive, 0) is MessageVerdict.MET
    for second in range(1, 20):
        assert one.handle_message(alive, second * S) is MessageVerdict.FITS
        assert one.timeout(second * S) is None
    # 5 s of silence, and a round trip.
    assert one.timeout(25 * S) is None and one.peer is not None and one.hears
    assert one.timeout(25 * S + 1) == "silence"
    assert (one.peer, one.hears, one.peer_life, one.checked) == (None, False, 5, True)
    assert one.timeout(26 * S) is None


def test_a_slave_that_does_not_confirm_is_waited_for_longer_and_longer():
    one = negotiation()
    waiting = from_peer(one, state=LinkState.CONFIGURE)
    assert one.obstacle()[0] is LinkState.SEARCH
    one.handle_message(waiting, 0)
    assert one.obstacle() == (LinkState.CONFIGURE, "waits for the slave to confirm")
    assert one.kind(LinkState.CONFIGURE) is MessageKind.CONFIGURE
    found = []
    for ms in range(0, 200_000, 100):
        one.handle_message(waiting, ms * MS)
        if one.timeout(ms * MS) == "answer":
            found.append(ms)
    # Four round trips, then twice as long each time.
    assert found == [4_100, 12_200, 28_300, 60_400, 124_500]
    confirm = from_peer(one, kind=MessageKind.CONFIRM, state=LinkState.APPROVE)
    one.handle_message(confirm, 200 * S)
    assert one.agreed and one.obstacle() is None
    assert one.kind(LinkState.APPROVE) is MessageKind.ALIVE
    # After an answer the next wait is the first one again.
    one.handle_message(waiting, 201 * S)
    assert one.timeout(205 * S) is None and one.timeout(205 * S + 1) == "answer"
    assert not one.agreed


def test_a_slave_confirms_what_its_master_configured():
    one = negotiation(master=False)
    alive = from_peer(one, master=True, state=LinkState.CONFIGURE)
    one.handle_message(alive, 0)
    assert one.obstacle() == (LinkState.CONFIGURE, "waits for the master to configure")
    assert one.kind(LinkState.CONFIGURE) is MessageKind.ALIVE
    asked = from_peer(one, master=True, state=LinkState.CONFIGURE, kind=MessageKind.CONFIGURE)
    one.handle_message(asked, 1)
    assert one.agreed and one.kind(LinkState.APPROVE) is MessageKind.CONFIRM
    assert one.kind(LinkState.REFUSED) is MessageKind.REJECT
    assert one.kind(LinkState.CHECK) is MessageKind.ALIVE
    # Its master needs no confirmation any more; and no slave waits for an answer.
    one.handle_message(alive, 2)
    assert one.agreed and one.kind(LinkState.APPROVE) is MessageKind.ALIVE
    assert one.timeout(5 * S) is None
    # A master that hears another life configures that one.
    one.handle_message(from_peer(one, master=True, heard=8), 3)
    assert not one.hears and one.obstacle()[1] == "the peer does not hear this end"


def test_a_wrong_message_counts_from_its_repetition_on():
    one = negotiation()
    one.handle_message(from_peer(one), 0)
    wrong = from_peer(one, digest=one.digest ^ 1)
    good = from_peer(one)
    assert one.handle_message(wrong, 1) is MessageVerdict.SUSPECT
    # In between, a good one ends the suspicion.
    assert one.handle_message(good, 2) is MessageVerdict.FITS
    assert one.handle_message(wrong, 3) is MessageVerdict.SUSPECT
    assert one.handle_message(wrong, 4) is MessageVerdict.REFUSED
    assert (one.peer, one.peer_life, one.checked, one.agreed) == (None, 0, False, False)
    assert one.obstacle()[0] is LinkState.REFUSED and "configuration differs" in one.refusal
    # Rates say more than "differs", and what is known is kept.
    rates = from_peer(
        one,
        kind=MessageKind.REJECT,
        digest=one.digest ^ 1,
        rates_kbps=(4000, 300),
    )
    assert one.handle_message(rates, 5) is MessageVerdict.REFUSED
    assert "uplink has 256 kbit/s here and 300 there" in one.refusal
    one.handle_message(wrong, 6)
    assert "300 there" in one.refusal
    assert one.handle_message(good, 7) is MessageVerdict.MET and one.refusal is None
    other = from_peer(one, life=6)
    assert one.handle_message(other, 8) is MessageVerdict.SUSPECT
    assert one.handle_message(other, 9) is MessageVerdict.DOUBTED
    assert one.handle_message(b"", 10) is MessageVerdict.MALFORMED
    both = from_peer(one, master=True)
    assert [one.handle_message(both, at) for at in (11, 12)] == [
        MessageVerdict.SUSPECT,
        MessageVerdict.REFUSED,
    ]
    assert "both ends are master" in one.refusal


def test_a_stranger_is_refused_only_while_the_peer_is_silent():
    one = negotiation()
    one.handle_message(from_peer(one), 0)
    wrong = from_peer(one, digest=one.digest ^ 1)
    for _ in range(3):
        assert one.handle_stranger(wrong, alone=False) is MessageVerdict.SUSPECT
    assert one.refusal is None
    assert one.handle_stranger(wrong, alone=True) is MessageVerdict.SUSPECT
    assert one.handle_stranger(wrong, alone=True) is MessageVerdict.REFUSED
    assert one.refusal is not None and one.peer is not None
    good = from_peer(one, life=77)
    assert one.handle_stranger(good, alone=False).life == 77 and one.refusal is not None
    assert one.handle_stranger(good, alone=True).life == 77 and one.refusal is None
    assert one.handle_stranger(bytes(12), alone=True) is MessageVerdict.MALFORMED
    # A known life is met again without anything being forgotten.
    one.agreed = True
    assert not one.meet(5) and one.agreed and one.peer is not None
    assert one.meet(77) and not one.agreed and one.peer is None and one.peer_life == 77
    one.handle_message(good, 5 * S)
    one.handle_contact(6 * S)
    assert (one.peer, one.message_ns, one.hears) == (None, 6 * S, False)


def test_an_application_link_is_reset_when_idle_and_when_broken():
    """2 s without data; a broken one after a round trip more, then twice as long each time."""
    watch = ApplicationWatch(TIMING, 0)
    assert not watch.fresh(0) and not watch.sending(0)
    watch.arrived_ns = watch.sent_ns = 10 * S
    watch.handle_first()
    assert watch.arrived and watch.fresh(12 * S - 1) and not watch.fresh(12 * S)
    assert watch.sending(12 * S - 1) and not watch.sending(12 * S)

    def due(now_ns, *, peer_fresh=False, approved=True):
        return watch.reset_due(peer_fresh=peer_fresh, approved=approved, now_ns=now_ns)

    assert due(12 * S - 1) is None
    assert due(12 * S, peer_fresh=True) is None and due(12 * S, approved=False) is None
    watch.sent_ns = 11 * S
    assert due(12 * S) is None and watch.arrived
    assert due(13 * S) == "idle" and not watch.arrived
    # The peer sends, and nothing comes.
    watch.handle_first()
    watch.handle_peer(was_reset=False, sends=True, now_ns=20 * S)
    watch.handle_peer(was_reset=False, sends=True, now_ns=21 * S)
    found = []
    for ms in range(20_000, 250_000, 100):
        if due(ms * MS, approved=False) == "broken":
            found.append(ms)
            assert not watch.arrived
    steps = [b - a for a, b in zip([20_000, *found], found, strict=False)]
    assert steps == [3_100, 5_100, 9_100, 17_100, 33_100, 65_100, 65_100]
    # Data at last: the waits are short again.
    watch.handle_first()
    watch.handle_contact(300 * S)
    assert not watch.arrived and due(303 * S, approved=False) is None
    watch.handle_peer(was_reset=False, sends=True, now_ns=301 * S)
    assert due(304 * S, approved=False) is None
    assert due(304 * S + 1, approved=False) == "broken"
    watch.handle_peer(was_reset=False, sends=False, now_ns=400 * S)
    assert due(500 * S, approved=False) is None


def test_a_reset_of_the_peer_is_followed_unless_data_comes():
    watch = ApplicationWatch(TIMING, 0)
    watch.handle_first()
    watch.arrived_ns = 5 * S
    watch.handle_peer(was_reset=True, sends=False, now_ns=7 * S - 1)
    assert watch.arrived
    watch.handle_peer(was_reset=False, sends=False, now_ns=8 * S)
    assert watch.arrived
    watch.handle_peer(was_reset=True, sends=False, now_ns=8 * S)
    assert not watch.arrived


def test_the_record_adds_up():
    record = SupervisionRecord(LinkState.CHECK, "starts", 10 * S)
    record.handle_state(LinkState.SEARCH, "checked", 11 * S)
    assert record.handle_signal_acquired(13 * S) == 3 * S
    # No signal was lost before the first one, so there was no gap.
    assert (record.longest_gap_ns, record.contact_ns(15 * S)) == (0, 2 * S)
    record.handle_state(LinkState.CONNECTED, "data", 14 * S)
    record.handle_state(LinkState.CONNECTED, "again", 15 * S)
    record.handle_signal_lost(16 * S)
    record.handle_state(LinkState.SEARCH, "lost", 17 * S)
    assert record.contact_ns(20 * S) == 3 * S
    assert record.handle_signal_acquired(21 * S) == 5 * S
    record.handle_signal_lost(22 * S)
    assert record.handle_signal_acquired(23 * S) == S
    assert record.longest_gap_ns == 5 * S and record.contact_ns(24 * S) == 5 * S
    assert record.since_ns == 7 * S
    times = record.in_state_ns(24 * S)
    assert {name: ns // S for name, ns in times.items() if ns} == {
        "check": 1,
        "search": 10,
        "connected": 3,
    }
    assert [(one.acquired_ns // S, one.connected_ns, one.lost_ns) for one in record.contacts] == [
        (3, 4 * S, 6 * S),
        (11, None, 12 * S),
        (13, None, None),
    ]
    assert [tuple(one.values()) for one in record.history][:3] == [
        (0, "check", "check", "starts"),
        (S, "check", "search", "checked"),
        (4 * S, "search", "connected", "data"),
    ]
    assert (record.counts["signals_acquired"], record.counts["signals_lost"]) == (3, 2)
    for number in range(100):
        record.handle_state(LinkState.SEARCH, str(number), 30 * S)
    assert len(record.history) == 64 and record.history[-1]["why"] == "99"


@pytest.mark.parametrize("known", [None, "self-test: broken"])
def test_frames_that_the_system_refuses_for_200_ms_are_a_fault(known):
    check = LocalCheck(known, 0)
    for ms in range(1, 200):
        check.handle_frames(ms, ms, "no route", ms * MS)
        assert check.fault == known
    check.handle_frames(200, 200, "no route", 200 * MS)
    fault = known or "this machine does not send the frames: no route"
    assert check.fault == fault
    # Without frames nothing is known anew; one that leaves ends it, and the time begins again.
    check.handle_frames(200, 200, "no route", 900 * MS)
    assert check.fault == fault
    check.handle_frames(202, 201, "no route", 901 * MS)
    assert check.fault == known
    check.handle_frames(203, 202, "no route", 1100 * MS)
    assert check.fault == known
    check.handle_frames(204, 203, "again", 1101 * MS)
    assert check.fault == (known or "this machine does not send the frames: again")
