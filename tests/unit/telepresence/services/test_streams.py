"""TCP services: every octet in order, with credit, at a bounded rate; closed with the signal."""

from random import Random

from service_pair import ServicePair

from kontur_av.clock import NS_PER_S
from telepresence.services.datagrams import (
    MOST_OCTETS,
    PART_OCTETS,
    OpenService,
    ResetReason,
    pack_service,
)
from telepresence.services.stream import WINDOW_OCTETS
from telepresence.services.streams import MOST_STREAMS

OCTETS = Random(1).randbytes(30_000)


def test_octets_go_both_ways_at_once_and_each_direction_ends_by_itself() -> None:
    pair = ServicePair()
    here, there = pair.opened()
    here.write(OCTETS, ends=True)
    there.write(OCTETS[::-1])
    pair.run(5)
    assert (there.read, here.read) == (OCTETS, OCTETS[::-1])
    assert (there.ended, here.ended, here.closed) == (True, False, False)
    there.write(b"bye", ends=True)
    pair.run(1)
    assert here.read.endswith(b"bye")
    assert [(one.closed, one.reason) for one in (here, there)] == [(True, None)] * 2
    for end in (pair.ground, pair.space):
        assert end.streams.poll_timeout(pair.now_ns) is None
        assert end.streams.counts.service_octets_resent == 0
        assert end.streams.counts.service_streams_ended == 1


def test_losses_are_repaired_within_a_few_round_trips() -> None:
    pair = ServicePair(3, loss=0.05)
    here, there = pair.opened()
    here.write(OCTETS)
    pair.run(8)
    assert there.read == OCTETS
    # What was lost, and little else.
    assert pair.ground.streams.report().service_octets_resent < len(OCTETS) // 5


def test_a_program_that_reads_nothing_holds_up_its_stream_alone() -> None:
    pair = ServicePair()
    (here, there), (other, other_there) = pair.opened(), pair.opened()
    there.reads = False
    here.write(OCTETS)
    other.write(OCTETS)
    pair.run(4)
    assert other_there.read == OCTETS
    # What is kept: the window at each end.
    assert len(here.wrote) == 2 * WINDOW_OCTETS
    there.reads = True
    pair.run(10)
    assert there.read == OCTETS


def test_the_rate_is_bounded_and_streams_share_it() -> None:
    pair = ServicePair(rate_bps=8_000)
    programs = [pair.opened() for _ in range(3)]
    sent = pair.sent_octets[pair.ground]
    for here, _ in programs:
        here.write(OCTETS)
    pair.run(20)
    assert pair.sent_octets[pair.ground] - sent <= 20 * 1000 + 2 * MOST_OCTETS
    came = [len(there.read) for _, there in programs]
    assert min(came) > 5_000
    assert max(came) - min(came) <= 2 * PART_OCTETS


def test_a_loss_of_signal_closes_all_streams_at_both_ends_and_a_new_one_works() -> None:
    pair = ServicePair()
    programs = [*pair.opened(), *pair.opened()]
    pair.contact = False
    pair.run(0.9)
    pair.contact = True
    pair.run(1)
    assert not any(program.closed for program in programs)
    pair.contact = False
    pair.run(1.1)
    assert [program.reason for program in programs] == [ResetReason.LOSS_OF_SIGNAL] * 4
    assert pair.ground.open(pair.now_ns) is None
    pair.contact = True
    pair.run(0.1)
    here, there = pair.opened()
    here.write(b"again")
    pair.run(1)
    assert there.read == b"again"


def test_only_a_few_streams_and_only_services_that_the_other_end_allows() -> None:
    pair = ServicePair()
    strange = pair.ground.open(pair.now_ns, "else")
    pair.run(1)
    assert strange is not None
    assert strange.reason == ResetReason.REFUSED
    assert not pair.space.programs
    for _ in range(MOST_STREAMS):
        pair.opened()
    assert pair.ground.open(pair.now_ns) is None
    # Those of the other end count for themselves.
    assert pair.space.open(pair.now_ns) is not None


def test_a_broken_connection_and_silence_in_contact_reset_a_stream() -> None:
    pair = ServicePair()
    here, there = pair.opened()
    pair.space.streams.handle_broken(next(iter(pair.space.programs)))
    pair.run(1)
    assert (here.reason, there.reason) == (ResetReason.BROKEN, ResetReason.BROKEN)
    here, _ = pair.opened()
    pair.space.work = lambda now_ns: []
    here.write(b"x")
    pair.run(29)
    assert not here.closed
    pair.run(2)
    assert here.reason == ResetReason.SILENT


def test_a_stream_without_data_is_reset_after_ten_minutes() -> None:
    pair = ServicePair()
    here, there = pair.opened()
    pair.run(590, NS_PER_S)
    assert not here.closed
    here.write(b"x")
    pair.run(590, NS_PER_S)
    assert not here.closed
    pair.run(20, NS_PER_S)
    assert here.closed
    assert there.closed


def test_an_end_that_was_started_again_knows_no_stream_and_the_other_one_learns_it() -> None:
    pair = ServicePair()
    here, _ = pair.opened()
    pair.space.restart(pair.now_ns)
    here.write(b"x")
    pair.run(2)
    assert here.reason == ResetReason.UNKNOWN
    # A quiet stream is found out by asking.
    _, there = pair.opened()
    pair.ground.restart(pair.now_ns)
    pair.run(120, NS_PER_S)
    assert not pair.space.programs
    assert there.closed
    # A new start of the opener closes the streams of the one before.
    _, there = pair.opened()
    pair.ground.restart(pair.now_ns)
    pair.run(0.1)
    pair.opened()
    assert there.reason == ResetReason.RESTARTED


def test_an_overtaken_opening_gives_no_octet_of_another_life_to_the_opener() -> None:
    pair = ServicePair()
    here, there = pair.opened()
    there.write(b"right")
    pair.run(1)
    (token,) = pair.ground.programs
    pair.space.restart(pair.now_ns)
    pair.run(0.1)
    pair.space.streams.handle_datagram(pack_service(OpenService(token, 7, "echo")), pair.now_ns)
    pair.step()
    wrong = pair.space.programs[token]
    wrong.write(b"12345wrong")
    pair.run(2)
    assert here.read == b"right"
    assert wrong.reason == ResetReason.UNKNOWN
