"""The joystick in operation: its states, its supervision, and who has its motors at the moment.

In each cycle: `handle_reading`, then the controller's force into `handle_force`, then let the
device `advance`. Left alone, it goes from init over its self-test and its calibration into the
application, and back into it after a halt whose cause is gone.
"""

from math import isfinite
from typing import Any

from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.haptics.device.calibration import Calibration, calibrate
from telepresence.haptics.device.device import JoystickDevice, Reading
from telepresence.haptics.device.script import IDLE, ScriptRun
from telepresence.haptics.device.states import REQUESTS, Event, State, StateMachine, Transition
from telepresence.haptics.device.supervision import Limits, Supervisor, Verdict

#: A sensor that is read this often without a fault has passed its self-test.
_SELF_TEST_CYCLES = 20
#: What goes wrong by itself is tried again after so long, and, where motors push, so often.
_RETRY_NS = NS_PER_S
_RETRIES = 3
#: After a halt or a release of the dead-man button the force comes back over this time.
_RETURN_NS = 300 * NS_PER_MS
#: What a controller may ask of a handle without motors. Nothing of it is felt, but the energies on
#: the way to the robot are those of a hand that feels it. Chosen.
FELT_BY_NOBODY_N = 10.0

#: As long as nothing but the sensors can have changed, only they are judged in each cycle; the
#: rest, which counts in seconds and minutes, is looked at so often.
_LOOK_NS = 10 * NS_PER_MS

#: What is refused as long as the supervisor has a reason to halt.
_NEED_HEALTH = (Event.CALIBRATE, Event.START, Event.RESUME)

_WELL, _APPLICATION = Verdict.WELL, State.APPLICATION


class Operation:
    """Runs one `device`; the reading that it gives is calibrated.

    automatic: make the requests itself that lead into the application, and back into it.
    hands_off: the application is a functional check: its script moves the handle, the dead-man
    button gives it no force, and no peer is expected.
    reading: the newest, calibrated. force_limit_n: what the controller may ask for until the next
    reading, per axis (N). Outside the application it is 0.
    """

    def __init__(
        self,
        device: JoystickDevice,
        *,
        limits: Limits | None = None,
        automatic: bool = True,
        hands_off: bool = False,
        now_ns: int = 0,
    ) -> None:
        self.device = device
        self.facts = device.facts
        self.machine = StateMachine(now_ns)
        self.supervisor = Supervisor(limits)
        self.calibration: Calibration | None = None
        self.reading = Reading(0.0, 0.0, 0.0, 0.0, dead_man=False)
        self.force_limit_n = 0.0
        self.prompt = ""
        self.released = 0
        self._automatic = automatic
        self._hands_off = hands_off
        self._most_n = self.facts.force_limit_n if self.facts.has_force else FELT_BY_NOBODY_N
        self._run: ScriptRun[Calibration] | None = None
        self._output = IDLE
        self._leds = -1
        self._shown: State | None = None
        self._cycles = 0
        self._retries = 0
        self._tried_ns = now_ns
        self._held_since_ns: int | None = None
        #: The force is back in full since the dead-man button was pressed.
        self._returned = False
        #: Until then the sensors alone are judged, by these limits: see `Supervisor.sensible`.
        self._look_ns = 0
        self._sensible = self.supervisor.sensible

    @property
    def state(self) -> State:
        """Where it stands."""
        return self.machine.state

    @property
    def reason(self) -> str:
        """Why it stands there, in one line; "" if that needs no words."""
        return self.machine.reason

    @property
    def given_up(self) -> bool:
        """Whether it has tried by itself often enough: a person must do something now.

        With motors it tries no more. A calibration without them pushes nobody: it goes on trying,
        until the stick is let go of.
        """
        if self.state in (State.CALIBRATION_ERROR, State.RECOVERABLE):
            return not self._automatic or self._retries >= _RETRIES
        return self.state is State.FATAL

    @property
    def trouble(self) -> str:
        """One line about what keeps it from the application; "" when nothing does."""
        reason = self.machine.reason or self.supervisor.reason
        return f"{self.state.words}: {reason}" if reason else ""

    @property
    def halted(self) -> bool:
        """Whether it can do nothing for the application until something has changed."""
        return self.machine.state >= State.HALTED

    def handle_heard(self, now_ns: int) -> None:
        """There is a fresh sample of the peer."""
        self.supervisor.handle_heard(now_ns)

    def handle_request(self, event: Event, now_ns: int, reason: str = "") -> str:
        """A person asks for `event`: "" if it was done, else one line that says why not."""
        if event not in REQUESTS:
            return f"{event.value}: nothing that can be asked for"
        self._look_ns = 0
        verdict = self.supervisor.verdict
        if event in _NEED_HEALTH and verdict is not Verdict.WELL:
            return f"{event.value}: not yet, {self.supervisor.reason}"
        if event is Event.ACKNOWLEDGE and verdict in (Verdict.FAULT, Verdict.FATAL):
            return f"{event.value}: not while {self.supervisor.reason}"
        refusal = self.machine.handle_event(event, now_ns, reason)
        if refusal:
            return refusal
        self._run = None
        if event is Event.CALIBRATE:
            self._forget_calibration()
            self._run = ScriptRun(calibrate(self.facts))
        elif event in (Event.RESUME, Event.START):
            self.supervisor.forget_silence()
            self._held_since_ns = None
            self._returned = False
            # All is well again: what goes wrong next is tried as often as the first time.
            self._retries = 0
        self.supervisor.expects_peer = not self._hands_off and event is Event.START
        return ""

    def handle_reading(self, now_ns: int) -> Reading:
        """Read the device, judge what it says, and go on with what is under way."""
        self.reading = reading = self.device.read()
        if now_ns < self._look_ns:
            x_m, y_m, vx_m_s, vy_m_s, _, dead_man, _, present = reading
            reach_x, reach_y, speed = self._sensible
            if (
                dead_man
                and present
                and -reach_x <= x_m <= reach_x
                and -reach_y <= y_m <= reach_y
                and -speed <= vx_m_s <= speed
                and -speed <= vy_m_s <= speed
            ):
                return reading
        self._look_ns = 0
        supervisor, machine = self.supervisor, self.machine
        # Compared by identity, and nothing looked up twice.
        verdict = supervisor.handle_reading(reading, now_ns)
        if verdict is not _WELL:
            self._handle_verdict(verdict, now_ns)
        if machine.state is not _APPLICATION:
            self.force_limit_n = 0.0
            self._go_on(reading, now_ns)
        elif self._returned and reading.dead_man:
            self.force_limit_n = self._most_n * supervisor.share
            self._look_ns, self._sensible = now_ns + _LOOK_NS, supervisor.sensible
        else:
            self._allow(reading, now_ns)
        return reading

    def handle_force(self, x_n: float, y_n: float, leds: int = 0) -> None:
        """What the application wants the motors and the LEDs to do; cut to what is allowed."""
        state = self.machine.state
        if state is State.APPLICATION:
            limit_n = self.force_limit_n
            if not (-limit_n <= x_n <= limit_n and -limit_n <= y_n <= limit_n):
                x_n = _cut(x_n, limit_n)
                y_n = _cut(y_n, limit_n)
        else:
            x_n, y_n, leds = self._output.x_n, self._output.y_n, self._output.leds
        if state is not self._shown:
            self._shown = state
            self.device.show_state(state)
        self.device.write_force(x_n, y_n)
        if leds != self._leds:
            self._leds = leds
            self.device.write_leds(leds)

    def next_event(self) -> Transition | None:
        """The next transition, or None."""
        return self.machine.next_event()

    def report(self) -> dict[str, Any]:
        """State, reason, temperatures (°C), counters."""
        supervisor, calibration = self.supervisor, self.calibration
        return {
            "device": self.facts.name,
            "state": self.machine.state.words,
            "reason": self.machine.reason or self.supervisor.reason,
            "temperature_c": _rounded(self.reading.temperature_c),
            "hottest_c": _rounded(supervisor.hottest_c),
            "temperature_warnings": supervisor.warnings,
            "force_share": round(supervisor.share, 3),
            "force_limit_n": round(self.force_limit_n, 3),
            "transitions": self.machine.entered,
            "refused": self.machine.refused,
            "dead_man_released": self.released,
            "calibration_mm": None
            if calibration is None
            else [
                round(value * 1e3, 2)
                for value in (
                    calibration.x_m,
                    calibration.y_m,
                    calibration.half_width_m,
                    calibration.half_height_m,
                )
            ],
        }

    def _allow(self, reading: Reading, now_ns: int) -> None:
        """In the application, not in the hand yet, or no more: how much force there may be."""
        self._returned = False
        if not reading.dead_man and not self._hands_off:
            if self._held_since_ns is not None:
                self.released += 1
            self._held_since_ns = None
            self.force_limit_n = 0.0
            return
        if self._held_since_ns is None:
            self._held_since_ns = now_ns
        held_ns = now_ns - self._held_since_ns
        self._returned = held_ns >= _RETURN_NS
        share = min(1.0, held_ns / _RETURN_NS)
        self.force_limit_n = self._most_n * self.supervisor.share * share

    def _handle_verdict(self, verdict: Verdict, now_ns: int) -> None:
        machine, reason = self.machine, self.supervisor.reason
        state = machine.state
        if verdict is Verdict.FATAL:
            if state is not State.FATAL:
                machine.handle_event(Event.FATAL_FAULT, now_ns, reason)
        elif verdict is Verdict.FAULT:
            if state not in (State.RECOVERABLE, State.FATAL):
                machine.handle_event(Event.FAULT, now_ns, reason)
                # It will be calibrated anew, and a place that is no place is no fault meanwhile.
                self._forget_calibration()
        elif state in (State.APPLICATION, State.CALIBRATED):
            machine.handle_event(Event.HALT, now_ns, reason)
        elif self._run is not None:
            machine.handle_event(Event.CALIBRATION_FAILED, now_ns, reason)
        if machine.state is not state:
            self._run = None
            self._output = IDLE
            self.prompt = ""
            self.supervisor.expects_peer = False

    def _go_on(self, raw: Reading, now_ns: int) -> None:
        """Outside the application: self-test, calibration, and what comes by itself."""
        machine = self.machine
        state = machine.state
        self._output = IDLE
        if state is State.INIT:
            self._cycles += 1
            if self._cycles >= _SELF_TEST_CYCLES:
                machine.handle_event(Event.SELF_TEST_PASSED, now_ns)
        elif self._run is not None:
            self._output = self._run.handle_reading(raw, now_ns)
            self.prompt = self._output.prompt
            found = self._run.result
            if found is not None:
                self._run = None
                self.prompt = ""
                if found.problem:
                    machine.handle_event(Event.CALIBRATION_FAILED, now_ns, found.problem)
                else:
                    self.calibration = found
                    self.device.set_zero(found.x_m, found.y_m)
                    self.supervisor.set_workspace(found.half_width_m, found.half_height_m)
                    machine.handle_event(Event.CALIBRATION_PASSED, now_ns)
        elif self._automatic:
            self._ask_by_itself(state, now_ns)

    def _forget_calibration(self) -> None:
        self.calibration = None
        self.supervisor.forget_workspace()

    def _ask_by_itself(self, state: State, now_ns: int) -> None:
        if state is State.STANDBY:
            self.handle_request(Event.CALIBRATE, now_ns)
        elif state is State.CALIBRATED:
            self.handle_request(Event.START, now_ns)
        elif state is State.HALTED:
            if self.supervisor.verdict is Verdict.WELL:
                self.handle_request(Event.RESUME, now_ns)
        elif (
            state in (State.CALIBRATION_ERROR, State.RECOVERABLE)
            and (self._retries < _RETRIES or not self.facts.has_force)
            and now_ns - max(self.machine.since_ns, self._tried_ns) >= _RETRY_NS
        ):
            self._tried_ns = now_ns
            # Refused as long as the cause is there: then it was no try.
            if not self.handle_request(Event.ACKNOWLEDGE, now_ns):
                self._retries += 1


def _rounded(temperature_c: float | None) -> float | None:
    return None if temperature_c is None else round(temperature_c, 1)


def _cut(force_n: float, limit_n: float) -> float:
    if not isfinite(force_n):
        return 0.0
    return limit_n if force_n > limit_n else -limit_n if force_n < -limit_n else force_n
