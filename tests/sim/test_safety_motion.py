"""Nothing moves that nobody ordered: random sequences, judged by rules that are written apart."""

from common import first_seed, repeats
from random_ends import Ends, NetworkEnds
from random_interruptions import may_move, random_sequence, run


def seeds(count):
    return range(first_seed(0), first_seed(0) + repeats(count))


def test_no_sequence_of_interruptions_moves_the_robot_without_a_new_press():
    moved = 0
    for seed in seeds(1500):
        cycles = random_sequence(seed)
        moved += any(may_move(cycles))
        assert not run(cycles), seed
    # The rules let it move in many of them, so that to hold for ever is no answer.
    assert moved > len(seeds(1500)) / 2


def test_no_interruption_of_both_ends_moves_the_robot_without_a_new_press():
    """Sequences of 20 s through a page's hand, joystick, channel and robot."""
    moved_ms = 0
    for seed in seeds(8):
        ends = Ends(seed)
        assert not ends.run(20_000), seed
        moved_ms += ends.moved_ms
    assert moved_ms > 500 * len(seeds(8))


def test_no_network_moves_the_robot_without_a_new_press():
    """Sequences of 6 s over networks that lose, delay, queue, repeat and reorder datagrams."""
    moved = 0
    for seed in seeds(12):
        ends = NetworkEnds(seed)
        assert not ends.run(6_000), seed
        moved += ends.moved_ms > 0
    assert moved > len(seeds(12)) / 3
