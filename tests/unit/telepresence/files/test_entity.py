"""Files from one end to the other: whole or not at all, in contact only, at a bounded rate."""

from random import Random

import pytest
from file_pair import FilePair

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ConfigError
from telepresence.files import pdus
from telepresence.files.entity import DONE, FAILED, MOST_SENDING, SUSPENDED, fenced
from telepresence.files.pdus import GET, LIST, REMOVE, RENAME, Eof, FileData, Key, Metadata
from telepresence.files.sides import MAX_FILE_OCTETS, file_sum

OCTETS = Random(1).randbytes(50_000)


def putting(octets=OCTETS, seconds=1, **options):
    """A pair, and its file f that has been under way for so long."""
    pair = FilePair(**options)
    pair.ground.files["f"] = octets
    transfer = pair.ground.put("f")
    pair.run(seconds)
    return pair, transfer


def hearing():
    """An entity that hears its peer at 0 ns."""
    entity = FilePair().ground.entity
    entity.handle_link(heard=True, waiting_octets=0, now_ns=0)
    return entity


def told(entity, now_ns):
    """What an entity sends now."""
    return list(map(pdus.parse_pdu, iter(lambda: entity.poll_transmit(now_ns), None)))


def idle(pair):
    return not pair.ground.entity.open and not pair.space.entity.open


def test_a_file_goes_each_way_and_several_at_once():
    pair = FilePair()
    pair.ground.files = {f"up{number}": OCTETS[number:] for number in range(3)}
    pair.space.files = {"down": OCTETS[7:]}
    sent = [pair.ground.put(name) for name in pair.ground.files]
    sent.append(pair.space.put("down", second="kept/down"))
    pair.run(10)
    assert [one.state for one in sent] == [DONE] * 4
    assert pair.ground.files["kept/down"] == OCTETS[7:]
    assert pair.space.files.items() >= {f"up{at}": OCTETS[at:] for at in range(3)}.items()
    assert pair.ground.entity.counts.file_octets_resent == 0


def test_a_loss_of_signal_suspends_and_the_next_contact_goes_on_to_the_octet():
    pair, transfer = putting(timeout_ns=5 * NS_PER_S)
    pair.contact = False
    pair.run(1)
    sent, octets = len(pair.sent), transfer.octets
    assert 0 < octets < len(OCTETS)
    assert pair.ground.entity.state_of(transfer) == SUSPENDED
    # Far longer than the other end may be silent in contact.
    pair.run(300)
    assert (len(pair.sent), transfer.octets) == (sent, octets)
    pair.contact = True
    pair.run(10)
    assert transfer.state == DONE
    assert pair.space.files["f"] == OCTETS
    counts = pair.ground.entity.report(pair.now_ns)
    # Only what was on its way is sent again.
    assert counts.file_octets_resent < 2_000
    assert counts.file_suspended_ns == pytest.approx(301 * NS_PER_S, abs=NS_PER_S)


def test_nothing_is_sent_while_the_link_has_no_room():
    pair, _ = putting(seconds=0)
    entity = pair.ground.entity
    entity.handle_link(heard=True, waiting_octets=2_000, now_ns=0)
    assert entity.poll_transmit(NS_PER_S) is None
    assert entity.poll_timeout(NS_PER_S) is None
    entity.handle_link(heard=True, waiting_octets=0, now_ns=NS_PER_S)
    assert entity.poll_transmit(NS_PER_S) is not None


def test_no_second_has_more_octets_than_the_rate():
    pair, _ = putting(OCTETS[:20_000], 0, rate_bps=8_000)
    for _ in range(10):
        before = len(pair.sent)
        pair.run(1)
        # 1,000 octets a second, and a PDU more than the mean at the most.
        assert sum(map(len, pair.sent[before:])) <= 1_000 + 2 * 528


def test_what_is_asked_of_the_other_directory():
    pair = FilePair()
    pair.space.files = {"a": OCTETS, "b": b"b"}
    ask = pair.ground.entity.ask
    got, listed = ask(GET, "a", "mine", 0), ask(LIST, "", "", 0)
    moved, gone = ask(RENAME, "b", "ü", 0), ask(REMOVE, "none", "", 0)
    missing = ask(GET, "none", "", 0)
    pair.run(10)
    assert (got.state, listed.state, moved.state) == (DONE, DONE, DONE)
    assert pair.ground.files == {"mine": OCTETS}
    assert listed.text == "a\nb"
    assert pair.space.files.keys() == {"a", "ü"}
    assert (gone.state, gone.reason) == (FAILED, "no such file")
    assert missing.state == FAILED
    kept = ask(REMOVE, "ü", "", pair.now_ns)
    pair.run(5)
    assert kept.state == DONE
    assert pair.space.files.keys() == {"a"}
    # A listing has no control characters.
    pair.space.files = {"a\x1b[2J": b"", "b": b"b"}
    listed = ask(LIST, "", "", pair.now_ns)
    pair.run(5)
    assert listed.text == "a?[2J\nb"


def test_a_killed_receiver_gets_the_file_again_and_a_killed_sender_leaves_nothing():
    pair, transfer = putting(timeout_ns=60 * NS_PER_S)
    pair.space.restart(pair.now_ns)
    pair.run(20)
    assert transfer.state == DONE
    assert pair.space.files["f"] == OCTETS
    pair.ground.put("f", pair.now_ns, "g")
    pair.run(1)
    pair.ground.restart(pair.now_ns)
    pair.run(200)
    assert "g" not in pair.space.files
    assert pair.space.entity.counts.file_transactions_failed == 1
    assert pair.space.entity.poll_timeout(pair.now_ns) is None


def test_an_end_that_nobody_answers_gives_up():
    pair, transfer = putting(b"f", 0, loss=1.0, timeout_ns=20 * NS_PER_S)
    asked = pair.ground.entity.ask(GET, "a", "b", 0)
    pair.run(60)
    assert (transfer.state, asked.state) == (FAILED, FAILED)
    assert "silent" in transfer.reason


def test_a_cancelled_file_ends_at_both_ends_and_leaves_nothing():
    pair, transfer = putting()
    pair.ground.entity.cancel(transfer.number, pair.now_ns)
    sent = len(pair.sent)
    pair.run(2)
    assert (transfer.state, transfer.reason) == (FAILED, "cancelled")
    assert not pair.space.files
    after = [pdus.parse_pdu(one) for one in pair.sent[sent:]]
    assert not any(isinstance(pdu, FileData) for pdu in after)
    (eof,) = [pdu for pdu in after if isinstance(pdu, Eof)]
    assert eof.checksum == file_sum(pdus.ChecksumType.CRC_32, OCTETS[: eof.size])
    assert idle(pair)
    with pytest.raises(ConfigError, match="under way"):
        pair.ground.entity.cancel(transfer.number, pair.now_ns)


@pytest.mark.parametrize("seconds", [0.0, 0.03, 1.0])
def test_a_cancelled_get_leaves_nothing_however_far_it_was(seconds):
    pair = FilePair()
    pair.space.files["f"] = OCTETS
    got = pair.ground.entity.ask(GET, "f", "f", 0)
    pair.run(seconds)
    pair.ground.entity.cancel(got.number, pair.now_ns)
    pair.run(5)
    assert (got.state, got.reason) == (FAILED, "cancelled")
    assert not pair.ground.files
    assert idle(pair)
    assert pair.space.entity.counts.file_octets_sent < len(OCTETS)


def test_an_end_that_says_nothing_at_all_is_noticed_early():
    pair, transfer = putting(seconds=9.9, loss=1.0)
    assert not pair.ground.entity.unanswered(transfer, pair.now_ns)
    pair.run(0.2)
    assert pair.ground.entity.unanswered(transfer, pair.now_ns)
    # The receiver of a file that takes long tells that it is there.
    slow, transfer = putting(seconds=0, rate_bps=8_000)
    for _ in range(40):
        slow.run(1)
        assert not slow.ground.entity.unanswered(transfer, slow.now_ns)
    assert transfer.octets < len(OCTETS)


@pytest.mark.rule("9")
@pytest.mark.parametrize(
    "name", ["", "/etc/passwd", "..", "a/../b", "a//b", ".hidden", "a/.b", "a\0", "a\n", "x" * 201]
)
def test_no_name_leaves_the_directory(name):
    with pytest.raises(ConfigError):
        fenced(name)
    key, entity = Key(2, 1, 5), hearing()
    with pytest.raises(ConfigError):
        entity.put("a", name or "..", b"", 0)
    # A peer's name is refused, and it is told.
    entity.handle_pdu(pdus.pack_pdu(Metadata(key=key, source="a", destination=name or "..")), 0)
    entity.handle_pdu(pdus.pack_pdu(Eof(key=key, size=0, checksum=bytes(4))), 0)
    assert entity.next_event() is None
    (finished,) = [pdu for pdu in told(entity, 0) if isinstance(pdu, pdus.Finished)]
    assert finished.condition != 0


def test_octets_that_were_changed_are_found_by_either_sum():
    entity, octets = hearing(), b"abcd"
    for number, (crc_of, sha256) in enumerate([(b"abce", b""), (octets, bytes(32))]):
        key = Key(2, 1, number)
        for pdu in (
            Metadata(key=key, size=4, source="a", destination="b", sha256=sha256),
            FileData(key=key, offset=0, data=octets),
            Eof(key=key, size=4, checksum=file_sum(pdus.ChecksumType.CRC_32, crc_of)),
        ):
            entity.handle_pdu(pdus.pack_pdu(pdu), 0)
        assert entity.next_event() is None


def test_a_peer_cannot_take_more_memory_than_a_file_may_have():
    entity = FilePair().ground.entity
    for number in range(20):
        key = Key(2, 1, number)
        entity.handle_pdu(pdus.pack_pdu(FileData(key=key, offset=MAX_FILE_OCTETS, data=b"x")), 0)
        entity.handle_pdu(pdus.pack_pdu(FileData(key=key, offset=0, data=b"x")), 0)
    assert entity.counts.file_requests_refused > 0
    assert entity.counts.file_octets_received == 0


def test_a_peer_gets_no_more_than_the_file_however_much_it_asks_for():
    entity = hearing()
    key = Key(1, 2, entity.put("a", "", b"abc", 0).number)
    first = told(entity, 0)
    entity.handle_pdu(
        pdus.pack_pdu(pdus.Nak(key=key, ranges=[(1, 1 << 31)], metadata=True)), NS_PER_S
    )
    assert told(entity, NS_PER_S) == [first[0], FileData(key=key, offset=1, data=b"bc")]


def test_the_end_of_a_file_is_told_again_until_the_receiver_has_finished():
    """It may have been killed after its acknowledgement."""
    entity = hearing()
    key = Key(1, 2, entity.put("a", "", b"abc", 0).number)
    eof = told(entity, 0)[-1]
    entity.handle_pdu(pdus.pack_pdu(pdus.Ack(key=key, of=pdus.DirectiveType.EOF_PDU)), 0)
    due_ns = entity.poll_timeout(0)
    assert due_ns is not None
    assert 3 * NS_PER_S < due_ns < 60 * NS_PER_S
    assert told(entity, due_ns) == [eof]


def test_who_missed_the_end_of_a_transaction_is_told_again():
    pair, transfer = putting(b"abc", 2)
    key = Key(1, 2, transfer.number)
    assert pair.ground.entity.poll_timeout(pair.now_ns) is None
    del pair.space.files["f"]
    (eof,) = [one for one in map(pdus.parse_pdu, pair.sent) if isinstance(one, Eof)]
    pair.space.entity.handle_pdu(pdus.pack_pdu(eof), pair.now_ns)
    assert [type(pdu) for pdu in told(pair.space.entity, pair.now_ns)] == [pdus.Ack, pdus.Finished]
    # It is no new transaction.
    assert pair.space.entity.poll_timeout(pair.now_ns) is None
    pair.ground.entity.handle_pdu(pdus.pack_pdu(pdus.Finished(key=key)), pair.now_ns)
    assert [type(pdu) for pdu in told(pair.ground.entity, pair.now_ns)] == [pdus.Ack]


def test_too_many_or_too_large_is_refused():
    entity = FilePair().ground.entity
    with pytest.raises(ConfigError, match="at most"):
        entity.put("a", "", bytes(MAX_FILE_OCTETS + 1), 0)
    for _ in range(MOST_SENDING):
        entity.put("a", "", b"", 0)
    with pytest.raises(ConfigError, match="at once"):
        entity.put("a", "", b"", 0)


def test_a_long_transfer_is_remembered_while_many_short_ones_end():
    pair, transfer = putting(seconds=0, rate_bps=64_000)
    for _ in range(70):
        pair.ground.entity.ask(REMOVE, "none", "", pair.now_ns)
        pair.run(0.1)
    assert pair.ground.entity.transfers[transfer.number] is transfer


def test_checksums_of_the_standard():
    """CRC-32 of the check string, and annex F's modular sum of words."""
    assert file_sum(pdus.ChecksumType.CRC_32, b"123456789").hex() == "cbf43926"
    assert file_sum(pdus.ChecksumType.MODULAR, bytes(range(15))).hex() == "181c2015"
    assert file_sum(pdus.ChecksumType.NULL_CHECKSUM, b"123") == bytes(4)
