"""Requirement: a reserve is kept while losses are reported, as much as they ask for."""

from telepresence.link.repair.reserve import Growth, Loss, Reserve

S = 1_000_000_000


def kept(losses, idle=0.1):
    reserve, seen = Reserve(), []
    for second, loss in enumerate(losses):
        reserve.handle_loss(loss, idle, second * S)
        seen.append(tuple(reserve.kept) if reserve.active else None)
    return seen


def test_the_reserve_follows_the_losses():
    assert kept([Loss()] * 5) == [None] * 5
    assert kept([Loss(20), Loss(100), Loss(500)]) == [(1, 0, 0), (1, 1, 6), (2, 4, 4)]
    # Packets that are lost nevertheless ask for more; where most slots are idle, no picture goes.
    assert kept([Loss(100, 20)]) == [(1, 2, 5)] and kept([Loss(100)], idle=0.8) == [(1, 1, 0)]
    # It falls slowly, and half a minute without a loss ends it.
    fallen = kept([Loss(500)] + [Loss(20)] * 31)
    assert [fallen[second] for second in (9, 10, 20, 30)] == [
        (2, 4, 4),
        (1, 2, 5),
        (1, 1, 6),
        (1, 0, 0),
    ]
    assert kept([Loss(20)] + [Loss()] * 31)[29:] == [(1, 0, 0), None, None]


def test_a_loss_is_measured_over_two_seconds_and_never_rounded_to_none():
    growth = Growth()
    counts = [growth.since(second * S, 1000 * second, second // 2) for second in range(6)]
    assert counts == [(0, 0), (1000, 0), (2000, 1), (2000, 1), (2000, 1), (2000, 1)]
    assert Loss.of(30_000, 1, 0) == Loss(1, 0) and Loss.of(0, 0, 0) == Loss()
