"""Runs the functional checks of a joystick: on virtual time, or live."""

from collections.abc import Callable

from kontur_av.clock import NS_PER_MS, NS_PER_S, Clock
from telepresence.haptics.device.checks import CheckBench
from telepresence.haptics.schedule import PeriodicSchedule

_CYCLE_NS = NS_PER_MS
#: The longest time for all checks.
_LONGEST_NS = 300 * NS_PER_S


def run_virtually(bench: CheckBench) -> float:
    """Run until all is done, or for 5 minutes. Return the seconds of virtual time."""
    now_ns = 0
    while not bench.done and now_ns < _LONGEST_NS:
        now_ns += _CYCLE_NS
        bench.handle_cycle(now_ns, _CYCLE_NS)
    return now_ns / NS_PER_S


def run_live(
    bench: CheckBench, clock: Clock, stopped: Callable[[], bool], ask: Callable[[str], None]
) -> float:
    """Run until all is done or `stopped`, or for 5 minutes. Return the seconds.

    ask: is told what a person should do now.
    """
    began_ns = now_ns = clock.now_ns()
    schedule = PeriodicSchedule(start_ns=began_ns, period_ns=_CYCLE_NS)
    prompt = ""
    while not bench.done and not stopped() and now_ns - began_ns < _LONGEST_NS:
        clock.sleep_until_ns(schedule.next_deadline_ns)
        now_ns = clock.now_ns()
        if schedule.handle_wakeup(now_ns) < 0:
            continue
        bench.handle_cycle(now_ns, schedule.advance_ns)
        if bench.prompt != prompt:
            prompt = bench.prompt
            if prompt:
                ask(prompt)
    return (now_ns - began_ns) / NS_PER_S
