"""What `benchmarks record` makes of torn files and of reports."""

from recordings import WALL_NS, Step, write

from benchmarks.record.figures import (
    Kill,
    RecordResult,
    cut,
    headlines,
    kill_of,
    scan_part,
)
from kontur_av.clock import NS_PER_MS, NS_PER_S

SCRIPT = [Step(100 * NS_PER_MS, 0, 0, b"x" * 900) for _ in range(30)]


def test_a_cut_loses_less_than_a_second_and_nothing_before():
    whole = write(SCRIPT)
    cuts = cut(whole.octets, 0)
    assert cuts.octets == cuts.cuts
    assert cuts.damaged == 0
    assert 0 < cuts.lost_s < 1


def test_a_kill_is_measured_from_the_last_message_that_can_be_read():
    whole = write(SCRIPT, end=False)
    torn = scan_part(memoryview(whole.octets + b"\x06torn"))
    assert torn.first_ns is not None and torn.last_ns is not None
    told = [one for one in whole.told if one.log_ns - WALL_NS <= torn.last_ns]
    assert len(told) == torn.messages < len(whole.told)
    kill = kill_of(3 * NS_PER_S, torn, None)
    assert kill.lost_s == (3 * NS_PER_S - torn.last_ns) / NS_PER_S
    assert not kill.damaged and kill.gap_s is None


def test_a_longer_loss_or_damage_is_a_failure():
    kills = (Kill(lost_s=0.4, gap_s=0.9, damaged=False, missing=0),)
    good = RecordResult(
        setup="spacejustin", seconds=5, kills=kills, cuts=None, without=(), recorded=()
    )
    assert good.sound and all(one.met is not False for one in headlines(good))
    for bad in (
        Kill(lost_s=1.01, gap_s=None, damaged=False, missing=0),
        Kill(lost_s=0.1, gap_s=None, damaged=True, missing=0),
    ):
        result = RecordResult(
            setup="spacejustin", seconds=5, kills=(*kills, bad), cuts=None, without=(), recorded=()
        )
        assert not result.sound
        assert any(one.met is False for one in headlines(result))
