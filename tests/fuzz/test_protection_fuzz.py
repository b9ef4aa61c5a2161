"""Invariant: whatever datagram comes, nothing raises, and it is counted once.

No frame comes out that the peer did not seal, none comes twice, and the session stays. This holds
for mutations that anybody can make, and for those of a peer that knows both identities, whose codes
are right: then the octets reach TLS.
"""

from random import Random

from common import first_seed, repeats
from mutated_octets import mutate
from protected_pair import ProtectedPair, S, connected

from telepresence.link.protection.channel import ProtectionMetrics
from telepresence.link.protection.datagrams import RECORD, HandshakeSegment, SegmentCodec

DATAGRAMS = repeats(4_000)
STRANGER = ("203.0.113.9", 4000)


def counted(metrics: ProtectionMetrics) -> int:
    return metrics.opened + metrics.handshake_datagrams + sum(metrics.dropped.values())


def mutated(datagram: bytes, random: Random) -> bytes:
    """Other octets: of any length, of another kind, or a mutation."""
    while True:
        choice = random.randrange(4)
        if choice == 0:
            octets = random.randbytes(random.choice((0, 1, 10, 25, 26, 27, 36, 37, 38, 600)))
        elif choice == 1:
            # The kinds lead to different parsers.
            octets = (
                bytes([random.choice((0x11, 0x12, 0x13, random.randrange(256)))]) + datagram[1:]
            )
        else:
            octets = mutate(random, datagram)
        if octets != datagram:
            return octets


def test_mutated_datagrams():
    random = Random(first_seed(11))
    pair = connected(rekey_records=2000)
    channel = pair.ground.channel
    samples = [datagram for end, datagram in pair.recorded if end is pair.space]
    opened = channel.metrics.opened
    for number in range(DATAGRAMS):
        got = channel.handle_datagram(
            mutated(random.choice(samples), random), STRANGER, pair.now_ns
        )
        pair.ground.received += 1
        assert got is None
        pair.drain(pair.ground)
        if number % 50 == 0:
            pair.step()
            samples[random.randrange(len(samples))] = next(
                datagram for end, datagram in reversed(pair.recorded) if end is pair.space
            )
            del pair.recorded[:-50]
    metrics = channel.metrics
    assert counted(metrics) == pair.ground.received
    assert metrics.opened - opened <= DATAGRAMS // 50 + 1
    assert metrics.dropped["malformed"] and metrics.dropped["unauthenticated"]
    assert channel.peer_address == pair.space.address
    pair.run(1)
    assert len(set(pair.ground.got)) == len(pair.ground.got)
    assert {*pair.ground.got} <= {*pair.space.sealed}
    assert pair.ground.got[-1] > pair.space.frames_sent - 5


def test_mutated_handshakes_of_who_knows_the_identities():
    """Each attempt is a true one, until one of its segments is mutated before its code is made."""
    random = Random(first_seed(12))
    handed = 0
    while handed < DATAGRAMS // 5:
        pair = ProtectedPair(seed=handed).start()
        receiver, sender = random.choice(((pair.ground, pair.space), (pair.space, pair.ground)))
        packs = SegmentCodec(sender.key.identity, receiver.key.identity).pack
        parses = SegmentCodec(receiver.key.identity, sender.key.identity).parse
        for _ in range(40):
            pair.step()
            for at, (due_ns, count, datagram, source, address) in enumerate(pair.path):
                segment = None if datagram[0] == RECORD else parses(datagram)
                if not isinstance(segment, HandshakeSegment) or random.random() < 0.5:
                    continue
                data = mutated(segment.data, random) if segment.data else random.randbytes(30)
                wrong = HandshakeSegment(
                    random.random() < 0.2,
                    segment.sender,
                    segment.receiver,
                    random.choice((segment.acknowledged, random.randrange(1 << 14))),
                    random.choice((segment.offset, random.randrange(1 << 13))),
                    data[:1100],
                )
                pair.path[at] = (due_ns, count, packs(wrong), source, address)
                handed += 1
        assert counted(receiver.channel.metrics) == receiver.received
        # The true peer is found as soon as it is left alone.
        pair.path.clear()
        until_ns = pair.now_ns + 60 * S
        got = [len(end.got) for end in pair.ends]
        while any(len(end.got) == count for end, count in zip(pair.ends, got, strict=True)):
            pair.step()
            assert pair.now_ns < until_ns
        assert counted(receiver.channel.metrics) == receiver.received
