"""Nothing moves that nobody ordered: random sequences, judged by rules that are written apart."""

from random_interruptions import may_move, random_sequence, run

SEQUENCES = 1_500


def test_no_sequence_of_interruptions_moves_the_robot_without_a_new_press():
    moved = 0
    for seed in range(SEQUENCES):
        cycles = random_sequence(seed)
        moved += any(may_move(cycles))
        assert not run(cycles), seed
    # The rules let it move in many of them, so that to hold for ever is no answer.
    assert moved > SEQUENCES / 2
