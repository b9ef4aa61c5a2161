"""Requirement: a reserve is kept while losses are reported, as much as they ask for."""

from telepresence.link.repair.reserve import Loss, Recent, Reserve

S = 1_000_000_000


def steps(losses, idle=0.1):
    reserve, seen = Reserve(), []
    for second, loss in enumerate(losses):
        reserve.handle_loss(loss, idle, second * S)
        seen.append(reserve.leave_out if reserve.active else None)
    return seen


def test_the_reserve_follows_the_losses():
    assert steps([Loss()] * 5) == [None] * 5
    # Where idle slots are enough, no picture is left out; with what stays lost, more and more.
    assert steps([Loss(100)] * 40, idle=0.8) == [0] * 40
    assert steps([Loss(100, 50)] * 9, idle=0.8) == [6] * 4 + [5] * 4 + [4]
    # Half a minute without a loss ends it.
    assert steps([Loss(100)] + [Loss()] * 31)[-3:] == [6, None, None]
    assert steps([Loss(1)] + [Loss()] * 20 + [Loss(1)] + [Loss()] * 29)[-1] is not None


def test_a_loss_is_measured_over_two_seconds_and_never_rounded_to_none():
    recent = Recent()
    counts = [recent.growth(second * S, 1000 * second, second // 2) for second in range(6)]
    assert counts == [(0, 0), (1000, 0), (2000, 1), (2000, 1), (2000, 1), (2000, 1)]
    assert Loss.of(30_000, 1, 0) == Loss(1, 0) and Loss.of(0, 0, 0) == Loss()
