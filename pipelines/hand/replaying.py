"""What sends again what was sent in a recorded session, at the same instants. Cores."""

from bisect import bisect_left
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipelines.hand.haptic_trace import (
    CONTACT,
    DEAD_MAN,
    axis_columns,
    lit_of,
    more_places,
    state_of,
)
from pipelines.hand.haptics import CYCLE_NS
from pipelines.session.probe import Probe
from pipelines.session.session_metrics import ContactRow, SampleReceivedRow, SampleSentRow, StepRow
from telepresence.haptics.axes import LEVER_M
from telepresence.haptics.loop import HapticLink, joystick_link, robot_link
from telepresence.haptics.sample import STATE_HALTED, Command, Feedback
from telepresence.haptics.step_detector import StepDetector

Row = Sequence[Any]

#: Rows that are turned into numbers of Python at once.
_AT_ONCE = 1000


class ReplayTime:
    """Turns instants of a recorded session into those of its replay.

    recorded_ns, replayed_ns: the same instant on both clocks. speed: seconds of the recording a
    second of the replay.
    """

    def __init__(self, *, recorded_ns: int, replayed_ns: int, speed: float = 1.0) -> None:
        self._recorded_ns, self._replayed_ns, self._speed = recorded_ns, replayed_ns, speed

    def at(self, recorded_ns: int) -> int:
        since_ns = recorded_ns - self._recorded_ns
        if self._speed != 1.0:
            since_ns = round(since_ns / self._speed)
        return self._replayed_ns + since_ns


class ReplayScript:
    """When a process sends its recorded items again. A core.

    Call `poll_due` at `poll_timeout` until it returns None.

    recorded_ns: instants of capture of the items, in order, on the recorded clock.
    cost_ns: an item is due this long after its capture.
    now_ns: items that are due before it are left out, so a restarted process repeats nothing.

    left_out: how many these are.
    """

    def __init__(
        self, recorded_ns: Sequence[int], time: ReplayTime, *, cost_ns: int, now_ns: int
    ) -> None:
        self._recorded_ns, self._time, self._cost_ns = recorded_ns, time, cost_ns
        self.left_out = self._next = bisect_left(recorded_ns, now_ns, key=self._due_ns)

    def poll_timeout(self) -> int | None:
        """When the next item is due; None after the last."""
        if self._next == len(self._recorded_ns):
            return None
        return self._due_ns(self._recorded_ns[self._next])

    def poll_due(self, now_ns: int) -> tuple[int, int] | None:
        """Return the number of an item that is due, and its instant of capture in the replay."""
        due_ns = self.poll_timeout()
        if due_ns is None or due_ns > now_ns:
            return None
        self._next += 1
        return self._next - 1, due_ns - self._cost_ns

    def _due_ns(self, recorded_ns: int) -> int:
        return self._time.at(recorded_ns) + self._cost_ns


class ReplayedEnd:
    """Robot or joystick of a recorded session: each cycle, the sample that was sent then.

    What arrives is counted and dated, but nothing answers it: forces and positions are those of the
    recording. A sample gets a number and a session of its own, because both belong to the exchange.
    Energies are 0, because there is no port that could grant any. Call it as the ends of
    `pipelines.hand.haptics`.

    rows: (n,), with the fields of `haptic_trace.ROW`, in order. robot: they are the robot's cycles,
    else the joystick's. boot_id: as in `RobotEnd`.

    Where two rows belong to one cycle, the newer one is sent; `superseded` counts the others.
    """

    def __init__(
        self, rows: NDArray[np.void], time: ReplayTime, probe: Probe, *, robot: bool, boot_id: int
    ) -> None:
        self._robot = robot
        axes = more_places(rows.dtype.names or ())
        make = robot_link if robot else joystick_link
        self._link: HapticLink[Any, Any] = make(boot_id=boot_id, more=len(axes))
        # Of each axis what the samples of this end carry, at its lever.
        self._levers = [LEVER_M if place.endswith("_rad") else 1.0 for place in axes]
        self._coming = _rows(rows, time, [axis_columns(place)[int(robot)] for place in axes])
        self._next = next(self._coming, None)
        self._probe = probe
        self._sent, self._received = probe.series(SampleSentRow), probe.series(SampleReceivedRow)
        self._contacts, self._felt = probe.series(ContactRow), probe.series(StepRow)
        self._touching = False
        self._steps = StepDetector()
        self.superseded = 0
        self.handle_datagram = self._link.handle_datagram
        self.poll_transmit = self._link.poll_transmit

    def handle_cycle(self, now_ns: int, advance_ns: int) -> None:
        """One cycle; the row of this cycle may be up to half a cycle late."""
        heard = self._link.latest(now_ns)
        if isinstance(heard, Feedback):
            self._steps.handle_sample(now_ns, heard.fx_n, heard.fy_n, heard.contact)
        row = None
        while self._next is not None and self._next[0] < now_ns + CYCLE_NS // 2:
            self.superseded += row is not None
            row, self._next = self._next, next(self._coming, None)
        if row is not None:
            self._send(row, now_ns)

    def _send(self, row: Row, now_ns: int) -> None:
        _, x_m, y_m, fx_n, fy_n, flags, *axes = row
        levers = self._levers
        more = tuple(
            (value / lever if self._robot else value * lever, 0, False)
            for value, lever in zip(axes, levers, strict=True)
        )
        touching = bool(flags & CONTACT)
        if self._robot:
            lit = lit_of(flags)
            if touching and not self._touching:
                self._contacts.add(ContactRow(now_ns, -1 if lit is None else lit))
            self._touching = touching
            self._link.handle_local(Feedback(fx_n, fy_n, 0, touching, lit=lit, more=more), now_ns)
        else:
            state = state_of(flags)
            command = Command(
                x_m, y_m, 0, bool(flags & DEAD_MAN), state, halted=state >= STATE_HALTED, more=more
            )
            self._link.handle_local(command, now_ns)

    def publish(self) -> None:
        """Put the counters and stamps into the probe."""
        link = self._link
        self._probe.publish(link.sent_metrics())
        self._probe.publish(link.received_metrics())
        self._sent.extend(link.take_sent_stamps())
        self._received.extend(link.take_received_stamps())
        while (step := self._steps.next_event()) is not None:
            self._felt.add(StepRow(step.instant_ns))


def _rows(rows: NDArray[np.void], time: ReplayTime, more: Sequence[str]) -> Iterator[Row]:
    """Instant in the replay, place, force and flags of each row, and these fields."""
    names = ["time_ns", "x_m", "y_m", "fx_n", "fy_n", "flags", *more]
    for first in range(0, len(rows), _AT_ONCE):
        for at_ns, *others in rows[names][first : first + _AT_ONCE].tolist():
            yield (time.at(at_ns), *others)
