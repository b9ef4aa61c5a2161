"""A bad link and killed processes: octets arrive as they were sent, or the stream is reset.

Never does a wrong octet come. Who was told that all has come has all of it, and a stream that one
end still has, the other one has, too. `python tests/fuzz/test_services_fuzz.py 1000` runs that
many sessions, outside CI.
"""

import sys
from random import Random

from mutated_octets import mutate
from service_pair import LocalProgram, ServiceEnd, ServicePair

from kontur_av.clock import NS_PER_MS
from kontur_av.errors import ProtocolError
from telepresence.services.datagrams import (
    OpenService,
    ResetReason,
    ResetStream,
    StreamPart,
    pack_service,
    parse_service,
)

DATAGRAMS = [
    OpenService(5, 6, "echo"),
    StreamPart(5, 6, 7, 8, 9, gap=3, data=b"abc"),
    StreamPart(5, 6, 7, 8, 9, data=b"a", last=True),
    StreamPart(5, 6, 7, 8, 9, ask=True),
    ResetStream(5, 6, ResetReason.IDLE),
]


def run(seed: int) -> int:
    """One session; return how many of its streams ended well."""
    random = Random(seed)
    pair = ServicePair(
        seed,
        loss=random.choice([0.0, 0.05, 0.3]),
        doubled=random.choice([0.0, 0.1]),
        overtaken=random.choice([0.0, 0.1]),
    )
    ends = (pair.ground, pair.space)
    streams: dict[int, list[LocalProgram]] = {}

    def look() -> None:
        """Join the programs of the two ends by their stream, and give new ones what to write."""
        for end in ends:
            for token, program in end.programs.items():
                known = streams.setdefault(token, [])
                if program not in known:
                    known.append(program)
                    size = random.choice([0, 1, 255, 256, 257, 5_000, 20_000])
                    program.write(random.randbytes(size), ends=random.random() < 0.7)

    def check() -> None:
        for known in streams.values():
            for one in known:
                # After a restart a stream may be opened again, towards nobody.
                assert any(other.wrote.startswith(one.read) for other in known if other != one) or (
                    one.read == b""
                )
                if one.ended:
                    assert any(o.wrote == one.read and o.ends for o in known if o is not one)

    for _ in range(40):
        if random.random() < 0.4:
            random.choice(ends).open(pair.now_ns)
        for _ in range(random.randrange(80)):
            pair.run(0.01)
            look()
        check()
        pair.contact = random.random() < 0.9
        if random.random() < 0.04:
            random.choice(ends).restart(pair.now_ns)
    pair.contact = True
    for _ in range(150):
        pair.run(2, 50 * NS_PER_MS)
        look()
        for one in (one for known in streams.values() for one in known):
            one.ends = True
        check()
    well = 0
    for known in streams.values():
        assert all(one.closed for one in known)
        # One end alone may take it for a failure: the last word to it may have come too late.
        well += len(known) == 2 and all(one.reason is None and one.ended for one in known)
    for end in ends:
        assert end.streams.poll_timeout(pair.now_ns) is None
        assert end.streams.counts.service_garbage == 0
    return well


def test_losses_overtaking_and_killed_processes_make_no_wrong_octet() -> None:
    assert sum(run(seed) for seed in range(12)) > 20


def converse(pair: ServicePair, end: ServiceEnd) -> bool:
    """A conversation by a new stream, both ways and to its end; whether it worked.

    It may fail if all streams are in use, or by an overtaken opening of an earlier life.
    """
    here = end.open(pair.now_ns)
    if here is None:
        return False
    (token,) = (token for token, program in end.programs.items() if program is here)
    other = pair.space if end is pair.ground else pair.ground
    there: LocalProgram | None = None
    for octets in (b"who", b"where is it" * 100):
        here.write(octets)
        for _ in range(3_000):
            pair.run(0.01)
            there = there or other.programs.get(token)
            if there is not None and len(there.read) > len(there.wrote + there.pending):
                there.write(there.read[len(there.wrote + there.pending) :])
            if here.read.endswith(octets) or here.closed:
                break
        if _restarted(here, there):
            return False
        assert here.read.endswith(octets)
    here.write(b"", ends=True)
    assert there is not None
    there.write(b"", ends=True)
    for _ in range(300):
        pair.run(0.1)
        if here.closed and there.closed:
            break
    if _restarted(here, there):
        return False
    assert (here.reason, here.ended, there.reason, there.ended) == (None, True, None, True)
    return True


def _restarted(*programs: LocalProgram | None) -> bool:
    return any(one is not None and one.reason == ResetReason.RESTARTED for one in programs)


def history(seed: int) -> int:
    """Conversations in one contact after the other, between cut off ones; return how many."""
    random = Random(seed)
    loss, overtaken = random.choice([0.0, 0.05]), random.choice([0.0, 0.1])
    pair = ServicePair(seed, loss=loss, doubled=overtaken, overtaken=overtaken)
    ends, conversations = (pair.ground, pair.space), 0
    for _ in range(30):
        for _ in range(random.randrange(6)):
            end = random.choice(ends)
            end.open(pair.now_ns)
            pair.run(random.choice([0.01, 0.3]))
            for token, program in list(end.programs.items()):
                program.write(random.randbytes(random.choice([0, 1, 5_000])))
                if random.random() < 0.2:
                    end.streams.handle_broken(token)
            if random.random() < 0.1:
                random.choice(ends).restart(pair.now_ns)
        for program in (program for end in ends for program in end.programs.values()):
            program.ends = True
        pair.contact = random.random() < 0.5
        pair.run(random.choice([0.3, 1.5, 5]))
        if random.random() < 0.1:
            random.choice(ends).restart(pair.now_ns)
        pair.contact = True
        pair.run(0.05)
        conversations += sum(converse(pair, end) or converse(pair, end) for end in ends)
    for _ in range(150):
        for program in (program for end in ends for program in end.programs.values()):
            program.ends = True
        pair.run(1)
    assert not any(end.programs or end.streams.open for end in ends)
    return conversations


def test_after_any_history_conversations_work_and_no_stream_is_left() -> None:
    # In the last one an overtaken opening meets a restarted end.
    assert sum(history(seed) for seed in (*range(5), 118)) == 360


def parse_mutations(mutations: int, seed: int) -> int:
    """Hand that many mutations to an end with streams; return how many were datagrams."""
    random, pair, parsed = Random(seed), ServicePair(), 0
    pair.opened()[0].write(bytes(9_000))
    for count in range(mutations):
        live = pair.ground.work(pair.now_ns + count) or [pack_service(random.choice(DATAGRAMS))]
        octets = mutate(random, live[0])
        try:
            parse_service(octets)
            parsed += 1
        except ProtocolError:
            pass
        for end in (pair.space, pair.ground):
            end.streams.handle_datagram(octets, pair.now_ns + count)
        pair.space.work(pair.now_ns + count)
    return parsed


def test_mutated_datagrams_are_refused_or_taken_and_never_end_the_process() -> None:
    assert parse_mutations(20_000, seed=1) > 1_000


if __name__ == "__main__":
    for seed in range(int(sys.argv[1])):
        run(seed)
        history(seed)
    print(parse_mutations(100 * int(sys.argv[1]), seed=2))
