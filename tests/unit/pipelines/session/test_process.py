"""When a process keeps its real-time priority."""

from kontur_av.clock import NS_PER_MS, NS_PER_S
from pipelines.session.process import RealtimeShare


def test_a_process_that_takes_more_than_half_a_core_for_two_seconds_loses_its_priority():
    share, now_ns, cpu_ns = RealtimeShare(), 5 * NS_PER_S, 40 * NS_PER_S

    def look(core, seconds):
        nonlocal now_ns, cpu_ns
        kept = []
        for _ in range(round(2 * seconds)):
            now_ns += NS_PER_S // 2
            cpu_ns += round(core * NS_PER_S / 2)
            share.handle_time(now_ns, cpu_ns)
            kept.append(share.kept)
        return kept

    # What it took before the first look does not count, nor does half a core, nor a short burst.
    assert all(look(0.5, 20))
    assert all(look(0.3, 20) + look(0.9, 0.5) + look(0.3, 20))
    cpu_ns += 1
    assert look(0.5, 2)[-1] is False
    # It does not get it back.
    assert not any(look(0.0, 10))


def test_half_a_core_is_judged_by_time_and_not_by_looks():
    share = RealtimeShare()
    for look in range(100):
        share.handle_time(look * 100 * NS_PER_MS, look * 49 * NS_PER_MS)
    assert share.kept
