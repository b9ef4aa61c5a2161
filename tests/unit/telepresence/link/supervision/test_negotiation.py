"""What one end makes of the other's messages: fits, is suspected, refused or doubted."""

from link_supervision_pair import GROUND, SPACE, alive

from telepresence.link.supervision.message import (
    LinkState,
    MessageKind,
    SupervisionTiming,
    pack_message,
)
from telepresence.link.supervision.negotiation import MessageVerdict, Negotiation

MS, S = 1_000_000, 1_000_000_000
TIMING = SupervisionTiming()


def negotiation(*, master=True):
    configuration = GROUND if master else SPACE
    return Negotiation(
        master=master, configuration=configuration, boot_id=9, timing=TIMING, now_ns=0
    )


def from_peer(of, **changes):
    """Octets of a matching peer of this negotiation."""
    table = {"version": of.version, "boot_id": 5, "heard": 9, "digest": of.digest}
    return pack_message(alive(**{**table, **changes}))


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
    assert (one.peer, one.hears, one.peer_boot_id, one.checked) == (None, False, 5, True)
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
    assert (one.peer, one.peer_boot_id, one.checked, one.agreed) == (None, 0, False, False)
    assert one.obstacle()[0] is LinkState.REFUSED and "configuration differs" in one.refusal
    # Rates say more than "differs", and what is known is kept.
    rates = from_peer(one, kind=MessageKind.REJECT, digest=one.digest ^ 1, rates_kbps=(4000, 300))
    assert one.handle_message(rates, 5) is MessageVerdict.REFUSED
    assert "uplink has 256 kbit/s here and 300 there" in one.refusal
    one.handle_message(wrong, 6)
    assert "300 there" in one.refusal
    assert one.handle_message(good, 7) is MessageVerdict.MET and one.refusal is None
    other = from_peer(one, boot_id=6)
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
        assert one.handle_unknown_sender(wrong, alone=False) is MessageVerdict.SUSPECT
    assert one.refusal is None
    assert one.handle_unknown_sender(wrong, alone=True) is MessageVerdict.SUSPECT
    assert one.handle_unknown_sender(wrong, alone=True) is MessageVerdict.REFUSED
    assert one.refusal is not None and one.peer is not None
    good = from_peer(one, boot_id=77)
    assert one.handle_unknown_sender(good, alone=False).boot_id == 77 and one.refusal is not None
    assert one.handle_unknown_sender(good, alone=True).boot_id == 77 and one.refusal is None
    assert one.handle_unknown_sender(bytes(12), alone=True) is MessageVerdict.MALFORMED
    # A known life is met again without anything being forgotten.
    one.agreed = True
    assert not one.meet(5) and one.agreed and one.peer is not None
    assert one.meet(77) and not one.agreed and one.peer is None and one.peer_boot_id == 77
    one.handle_message(good, 5 * S)
    one.handle_contact(6 * S)
    assert (one.peer, one.message_ns, one.hears) == (None, 6 * S, False)
