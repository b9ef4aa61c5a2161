"""A partner's joystick or robot, which exchanges samples with a session at 1 kHz. A shell."""

import socket
from collections.abc import Callable

from kontur_av.clock import NS_PER_MS, NS_PER_S, MonotonicClock
from pipelines.hand.haptics import CYCLE_NS
from pipelines.session.children import stopped_by_signals
from pipelines.session.datagrams import Outlet, OwnOutlet, receive
from pipelines.session.process import take_realtime
from pipelines.session.topology import LOOP_PRIORITY
from telepresence.haptics.bilateral import JoystickSide, RobotSide
from telepresence.haptics.sample import SAMPLE_OCTETS
from telepresence.haptics.schedule import PeriodicSchedule

#: How often it looks whether the robot answers.
_LOOK_NS = 100 * NS_PER_MS


def told(side: JoystickSide | RobotSide, peer: str) -> int:
    """Print what went to the peer and came from it; return 0 if something came, else 1."""
    figures = side.link
    print(
        f"{figures.sent} samples to the {peer}, {figures.received} from it, "
        f"{figures.lost} lost, {figures.garbage} garbage"
    )
    return 0 if figures.received else 1


def run_side(
    side: JoystickSide | RobotSide,
    before: Callable[[int], None],
    way: tuple[socket.socket, Outlet | OwnOutlet],
    seconds: float | None,
) -> None:
    """Run one side of the exchange at 1 kHz until it is stopped; before: called in each cycle."""
    own, to_session = way
    link = side.link
    who, peer = ("joystick", "robot") if isinstance(side, JoystickSide) else ("robot", "joystick")
    clock = MonotonicClock()
    now_ns = clock.now_ns()
    end_ns = None if seconds is None else now_ns + round(seconds * NS_PER_S)
    schedule = PeriodicSchedule(start_ns=now_ns, period_ns=CYCLE_NS)
    answers, look_ns = False, now_ns
    print(f"{who}: waiting for the {peer}; Ctrl-C ends", flush=True)
    take_realtime(LOOP_PRIORITY)
    with stopped_by_signals() as stopped:
        while not stopped() and (end_ns is None or now_ns < end_ns):
            clock.sleep_until_ns(schedule.next_deadline_ns)
            now_ns = clock.now_ns()
            if schedule.handle_wakeup(now_ns) < 0:
                continue
            while (datagram := receive(own, SAMPLE_OCTETS + 1)) is not None:
                side.handle_datagram(datagram, now_ns)
            before(now_ns)
            side.handle_cycle(now_ns, schedule.advance_ns)
            sample = side.poll_transmit(now_ns)
            if sample is not None:
                to_session.send(sample)
            if now_ns < look_ns:
                continue
            look_ns = now_ns + _LOOK_NS
            if link.hearing is not answers:
                answers = link.hearing
                print(f"{who}: the {peer} {'answers' if answers else 'is silent'}", flush=True)
