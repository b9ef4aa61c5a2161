"""Numbers that a peer must echo."""

from telepresence.link.supervision.challenge import Proof
from telepresence.link.supervision.message import SupervisionTiming

MS = 1_000_000


def test_a_number_counts_once_and_only_for_a_while():
    proof = Proof(seed=3, timing=SupervisionTiming(round_trip_ns=100 * MS))
    first = proof.number(0)
    assert proof.number(99 * MS) == first
    second = proof.number(100 * MS)
    assert second != first
    assert not proof.answers(0, 101 * MS)
    assert not proof.answers(first ^ second, 101 * MS)
    assert proof.answers(first, 199 * MS)
    assert not proof.answers(first, 199 * MS)
    third = proof.number(200 * MS)
    assert third not in (first, second)
    assert not proof.answers(second, 201 * MS)  # It went with the first.
    assert not proof.answers(third, 400 * MS)
    assert proof.number(401 * MS) != third
    assert proof.answers(third, 402 * MS) is False
