"""A bad link and killed processes: a file arrives as it was, or its failure is reported.

Never is a wrong file kept, and never is one reported as arrived that has not.
"""

from random import Random

from common import first_seed, repeats
from file_pair import FilePair
from mutated_octets import mutate

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ProtocolError
from telepresence.files import pdus
from telepresence.files.entity import DONE, FAILED
from telepresence.files.pdus import GET, LIST, REMOVE, RENAME, Eof, Metadata, Request, pack_pdu

KEY, ORIGIN = pdus.Key(2, 1, 77), pdus.Key(1, 2, 9)
PDUS = [
    Metadata(
        key=KEY, size=5, source="a", destination="b", sha256=bytes(32), origin=pdus.Key(1, 2, 9)
    ),
    *(Metadata(key=KEY, request=Request(kind, "x")) for kind in (LIST, REMOVE)),
    *(Metadata(key=KEY, request=Request(kind, "x", "é")) for kind in (GET, RENAME)),
    pdus.FileData(key=KEY, offset=1, data=b"abc"),
    Eof(key=KEY, size=5, checksum=bytes(4)),
    Eof(key=KEY, size=5, checksum=bytes(4), condition=pdus.ConditionCode.CANCEL_REQUEST_RECEIVED),
    pdus.Ack(key=KEY, of=pdus.DirectiveType.EOF_PDU),
    pdus.Ack(key=KEY, of=pdus.DirectiveType.FINISHED_PDU),
    pdus.Nak(key=KEY, ranges=[(1, 4)], metadata=True),
    pdus.Finished(key=KEY, request=Request(RENAME, "x", "y"), reason="no"),
]


def run(seed):
    """One session; return how many of its files arrived."""
    random = Random(seed)
    pair = FilePair(
        seed,
        loss=random.choice([0.0, 0.05, 0.3]),
        doubled=random.choice([0.0, 0.1]),
        overtaken=random.choice([0.0, 0.1]),
        timeout_ns=30 * NS_PER_S,
    )
    ends = {"ground": pair.ground, "space": pair.space}
    lives = dict.fromkeys(ends, 0)
    sent = []
    for number in range(4):
        end = random.choice(list(ends))
        octets = random.randbytes(random.choice([0, 1, 511, 512, 513, 5_000, 20_000]))
        name = f"file{number}"
        ends[end].files[name] = octets
        sent.append((end, name, octets, ends[end].put(name)))
    for _ in range(20):
        pair.run(random.random() * 2)
        pair.contact = random.random() < 0.7
        if random.random() < 0.08:
            killed = random.choice(list(ends))
            ends[killed].restart(pair.now_ns)
            lives[killed] += 1
    pair.contact = True
    pair.run(300, 50 * NS_PER_MS)
    arrived = 0
    for end, name, octets, transfer in sent:
        there = ends["space" if end == "ground" else "ground"].files
        assert there.get(name, octets) == octets, seed
        # A process that was killed reports nothing any more.
        assert transfer.state in (DONE, FAILED) or lives[end]
        assert transfer.state != DONE or name in there
        arrived += name in there
    for one in ends.values():
        assert one.entity.poll_timeout(pair.now_ns) is None
    return arrived


def test_losses_overtaking_and_killed_processes_leave_no_wrong_file():
    seeds = range(first_seed(0), first_seed(0) + repeats(25))
    assert sum(map(run, seeds)) > 3 * len(seeds)


def test_mutated_pdus_are_refused_or_taken_and_never_end_the_process():
    assert [pdus.parse_pdu(pack_pdu(pdu)) for pdu in PDUS] == PDUS
    random, ground = Random(first_seed()), FilePair().ground
    originals, parsed = [pack_pdu(pdu) for pdu in PDUS], 0
    for count in range(repeats(20_000)):
        octets = mutate(random, random.choice(originals))
        try:
            pdus.parse_pdu(octets)
            parsed += 1
        except ProtocolError:
            pass
        ground.entity.handle_pdu(octets, count)
        ground.work(count)
    assert parsed > 1_000
