"""The joystick in operation: its states, its supervision, and the control of its motors.

In each cycle: call `handle_reading`, pass the controller's force to `handle_force`, then let the
device `advance`. By default it goes from init through self-test and calibration to the application
by itself. It returns there after a halt once the cause is gone.
"""

from math import isfinite

from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.haptics.device.calibration import Calibration, calibrate
from telepresence.haptics.device.device import JoystickDevice, JoystickReading
from telepresence.haptics.device.functional_test import Outcome, TestReport, functional_test
from telepresence.haptics.device.script import IDLE, ScriptRun
from telepresence.haptics.device.states import (
    REQUESTS,
    TRANSITIONS,
    ExperimentName,
    JoystickEvent,
    JoystickState,
    StateMachine,
    Transition,
)
from telepresence.haptics.device.supervision import Health, JoystickSupervisor, Limits
from telepresence.haptics.haptic_metrics import OperationMetrics

#: The self-test passes after this many readings without a fault.
_SELF_TEST_CYCLES = 20
#: Delay before an automatic retry after an error, and the number of retries on motors.
_RETRY_NS = NS_PER_S
_RETRIES = 3
#: After a halt or a release of the dead-man button the force returns over this time.
_RETURN_NS = 300 * NS_PER_MS
#: Force limit for a handle without motors. Nobody feels this force, but the energies sent to the
#: robot must be those of a hand that feels it. Chosen.
UNFELT_FORCE_LIMIT_N = 10.0

#: Full supervision runs at this interval. Between, only the sensors are compared with their limits,
#: because everything else changes within seconds or minutes.
_CHECK_NS = 10 * NS_PER_MS

#: Requests that are refused while the supervisor has a reason to halt.
_NEED_HEALTH = (
    JoystickEvent.CALIBRATE,
    JoystickEvent.START,
    JoystickEvent.RESUME,
    JoystickEvent.TEST,
)

#: A person's commands that resume a halted joystick first.
_FROM_HALTED = (JoystickEvent.CALIBRATE, JoystickEvent.START)
_BY_A_PERSON = "by a person's command"

_NO_BOARD = 'this session has no partner\'s robot: its setup needs partner_arm = "board"'
_NO_PARTNER = "the partner's robot is not there"
#: Whom the joystick hears.
_PEERS = {ExperimentName.GERMAN: "the robot", ExperimentName.RUSSIAN: "the partner's robot"}

_OK, _APPLICATION = Health.OK, JoystickState.APPLICATION

#: By state: the request that leads on.
_NEXT = {
    JoystickState.STANDBY: JoystickEvent.CALIBRATE,
    JoystickState.CALIBRATED: JoystickEvent.START,
    JoystickState.HALTED: JoystickEvent.RESUME,
    JoystickState.CALIBRATION_ERROR: JoystickEvent.ACKNOWLEDGE,
    JoystickState.RECOVERABLE: JoystickEvent.ACKNOWLEDGE,
}


class JoystickOperation:
    """Runs one `device`.

    automatic: make the requests that lead into the application, and back into it, by itself.
    paused: how a person halted or stopped it, in an earlier start too, so it waits for a person;
    "": it does not.
    hands_off: the application is a functional check, without dead-man button and peer.

    reading: the newest reading; its position is calibrated once `calibration` is set.
    force_limit_n: the force (N) that the controller may use until the next reading, per axis; 0
    outside the application.
    test: the newest functional test.
    experiment: of the present or the next application. partner: whether a partner's robot is there,
    which the caller sets; None: there can be none.
    policy, driver: of a joystick that pages move, which the caller sets: the policy that may drive,
    and who has the handle; "" for none. handed: as `JoystickStatus` has it.
    """

    def __init__(
        self,
        device: JoystickDevice,
        *,
        limits: Limits | None = None,
        automatic: bool = True,
        hands_off: bool = False,
        paused: str = "",
    ) -> None:
        self.device = device
        self.capabilities = device.capabilities
        self.machine = StateMachine()
        self.supervisor = JoystickSupervisor(limits)
        self.calibration: Calibration | None = None
        self.reading = JoystickReading(0.0, 0.0, 0.0, 0.0, dead_man=False)
        self.force_limit_n = 0.0
        self.released = 0
        self.experiment = ExperimentName.GERMAN
        self.partner: bool | None = None
        self.policy = self.driver = ""
        self.handed = (0, "")
        self.test = TestReport()
        self._automatic = automatic
        self._hands_off = hands_off
        self._full_force_n = (
            self.capabilities.force_limit_n if self.capabilities.has_force else UNFELT_FORCE_LIMIT_N
        )
        self._run: ScriptRun[Calibration] | None = None
        self._test: ScriptRun[TestReport] | None = None
        self._output = IDLE
        self._leds = -1
        self._shown: JoystickState | None = None
        self._cycles = 0
        self._retries = 0
        #: How a person has halted or stopped it, who must let it go on.
        self.paused = paused
        self._tried_ns = 0
        self._held_since_ns: int | None = None
        #: The dead-man button was seen released since the application began.
        self._let_go = False
        #: The full force has returned since the dead-man button was pressed.
        self._force_restored = False
        #: Until then only the sensors are compared with `_plausible`; see `JoystickSupervisor`.
        self._check_ns = 0
        self._plausible = self.supervisor.plausible

    @property
    def state(self) -> JoystickState:
        """The state that the joystick is in."""
        return self.machine.state

    @property
    def prompt(self) -> str:
        """What a person should do for a calibration or a test; "" for nothing."""
        return self._output.prompt

    @property
    def testing(self) -> bool:
        """Whether the functional test has the handle."""
        return self._test is not None

    @property
    def reason(self) -> str:
        """Why it is in that state, in one line; "" if there is nothing to say."""
        machine = self.machine
        return machine.reason or ("" if machine.state is _APPLICATION else self.paused)

    @property
    def given_up(self) -> bool:
        """Whether the automatic retries have ended, so that a person must act."""
        if self.state in (JoystickState.CALIBRATION_ERROR, JoystickState.RECOVERABLE):
            return not self._automatic or self.paused != "" or not self._retries_left
        return self.state is JoystickState.FATAL

    @property
    def held(self) -> bool:
        """Whether the dead-man button is pressed, for a functional test, too."""
        return self.reading.dead_man

    @property
    def due_request(self) -> str:
        """The request of a person that leads on to the application; "" if it goes on by itself."""
        state, health = self.state, self.supervisor.health
        error = state in (JoystickState.CALIBRATION_ERROR, JoystickState.RECOVERABLE)
        by_itself = self._automatic and not self.paused and (self._retries_left or not error)
        refused = health is not Health.OK and not (error and health is Health.HALT)
        if by_itself or refused or self._run is not None or self._test is not None:
            return ""
        return _NEXT[state].value if state in _NEXT else ""

    @property
    def _retries_left(self) -> bool:
        return self._retries < _RETRIES or not self.capabilities.has_force

    @property
    def trouble(self) -> str:
        """One line that says what keeps it from the application; "" if nothing does."""
        reason = self.machine.reason or self.supervisor.reason
        return f"{self.state.words}: {reason}" if reason else ""

    def handle_heard(self, now_ns: int) -> None:
        """A fresh sample of the peer has arrived."""
        self.supervisor.handle_heard(now_ns)

    def handle_exercise(self, until_ns: int) -> None:
        """Take every reading for a fault until `until_ns`: a trainer's exercise."""
        self._check_ns = 0
        self.supervisor.handle_exercise(until_ns)

    def handle_request(self, event: JoystickEvent, now_ns: int, reason: str = "") -> str:
        """Carry out a person's request; return "" or one line that says why it was refused."""
        if event not in REQUESTS:
            return f"{event.value}: not a request"
        self._check_ns = 0
        health = self.supervisor.health
        if event in _NEED_HEALTH and health is not Health.OK:
            return f"{event.value}: not yet, {self.supervisor.reason}"
        if event is JoystickEvent.ACKNOWLEDGE and health in (Health.FAULT, Health.FATAL):
            return f"{event.value}: not while {self.supervisor.reason}"
        refusal = self.machine.handle_event(event, now_ns, reason)
        if refusal:
            return refusal
        self._end_script(f"{event.value}: {reason or _BY_A_PERSON}")
        if event is JoystickEvent.TEST:
            self._test = ScriptRun(functional_test(self.capabilities))
            self.test = TestReport(Outcome.RUNNING, number=self.test.number + 1)
        if event is JoystickEvent.CALIBRATE:
            self._forget_calibration()
            self._run = ScriptRun(calibrate(self.capabilities))
        elif event in (JoystickEvent.RESUME, JoystickEvent.START):
            self.supervisor.forget_silence()
            self._held_since_ns = None
            self._let_go = self._force_restored = False
            # The joystick is in order again, so later errors get all retries.
            self._retries = 0
        self.supervisor.expects_peer = not self._hands_off and event is JoystickEvent.START
        return ""

    def handle_command(self, event: JoystickEvent, now_ns: int, by: str = _BY_A_PERSON) -> str:
        """Carry out a person's command to an automatic joystick; otherwise as `handle_request`.

        halt, stop: nothing happens by itself until a person lets it go on. They also end a
        calibration, and are refused only after a fatal error.
        start: it goes on by itself from self-test, standby and calibration; from halted, it resumes
        and starts. start_russian: the same with the partner's robot; start: with ours.
        resume: it goes on by itself.
        calibrate: from halted, it resumes first. A pause stays.
        test: where it is calibrated, so that a person stops it first. A pause stays.
        policy, person: the pages' seat hands over, where a policy is there.
        by: who gives it, in words.
        """
        if event is JoystickEvent.START_RUSSIAN:
            if self.partner is not True and self.state is not JoystickState.FATAL:
                return f"{event.value}: {_NO_BOARD if self.partner is None else _NO_PARTNER}"
            return self._start(ExperimentName.RUSSIAN, now_ns)
        if event is JoystickEvent.START:
            return self._start(ExperimentName.GERMAN, now_ns)
        over = event in (JoystickEvent.POLICY, JoystickEvent.PERSON)
        if over and self.state is not JoystickState.FATAL:
            if not self.policy or (self.driver and event is JoystickEvent.POLICY):
                return f"{event.value}: {self.driver or 'no policy'} is at the handle"
            self.handed = (self.handed[0] + 1, event.value)
            return ""
        return self._command(event, now_ns, by)

    def choose(self, experiment: ExperimentName) -> None:
        """The application, the present one or the next, is of this experiment."""
        if experiment is not self.experiment:
            self.experiment = experiment
            self.supervisor.peer = _PEERS[experiment]
            self.supervisor.handle_new_peer()

    def _start(self, experiment: ExperimentName, now_ns: int) -> str:
        before = self.experiment
        if self.state is not JoystickState.APPLICATION:
            self.choose(experiment)
        refusal = self._command(JoystickEvent.START, now_ns)
        if refusal:
            self.choose(before)
        return refusal

    def _command(self, event: JoystickEvent, now_ns: int, by: str = _BY_A_PERSON) -> str:
        state = self.machine.state
        if event in (JoystickEvent.HALT, JoystickEvent.STOP):
            return self._pause(event, now_ns, by)
        if event is JoystickEvent.START and state in (JoystickState.INIT, JoystickState.STANDBY):
            self.paused = ""
            return ""
        if state is JoystickState.HALTED and event in _FROM_HALTED:
            refusal = self.handle_request(JoystickEvent.RESUME, now_ns)
            if refusal:
                return f"{event.value}: {refusal.partition(': ')[2]}"
        refusal = self.handle_request(event, now_ns)
        if not refusal and event in (JoystickEvent.START, JoystickEvent.RESUME):
            self.paused = ""
        return refusal

    def handle_reading(self, now_ns: int) -> JoystickReading:
        """Read the device, supervise the reading, and continue what is in progress."""
        self.reading = reading = self.device.read()
        if now_ns < self._check_ns:
            x_m, y_m, vx_m_s, vy_m_s, _, dead_man, _, present, error, _, _ = reading
            reach_x, reach_y, speed = self._plausible
            if (
                dead_man
                and present
                and not error
                and -reach_x <= x_m <= reach_x
                and -reach_y <= y_m <= reach_y
                and -speed <= vx_m_s <= speed
                and -speed <= vy_m_s <= speed
            ):
                return reading
        self._check_ns = 0
        supervisor, machine = self.supervisor, self.machine
        # Runs at 1 kHz: compare by identity and look nothing up twice.
        health = supervisor.handle_reading(reading, now_ns)
        if health is not _OK:
            self._handle_health(health, now_ns)
        if machine.state is not _APPLICATION:
            self.force_limit_n = 0.0
            self._continue_startup(reading, now_ns)
        elif self._force_restored and reading.dead_man:
            self.force_limit_n = self._full_force_n * supervisor.share
            self._check_ns, self._plausible = now_ns + _CHECK_NS, supervisor.plausible
        else:
            self._update_force_limit(reading, now_ns)
        return reading

    def handle_force(self, x_n: float, y_n: float, leds: int = 0) -> None:
        """Set the force (N, N) and the LEDs that the application wants, within the limits."""
        state = self.machine.state
        if state is JoystickState.APPLICATION:
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
        """The oldest transition that was not fetched yet, or None."""
        return self.machine.next_event()

    def report(self) -> OperationMetrics:
        """Return state, reason, temperatures (°C) and counters."""
        supervisor, calibration = self.supervisor, self.calibration
        return OperationMetrics(
            device=self.capabilities.name,
            state=self.machine.state.words,
            reason=self.reason or self.supervisor.reason,
            temperature_c=_rounded(self.reading.temperature_c),
            hottest_c=_rounded(supervisor.hottest_c),
            temperature_warnings=supervisor.warnings,
            force_share=round(supervisor.share, 3),
            force_limit_n=round(self.force_limit_n, 3),
            transitions=self.machine.entered,
            refused=self.machine.refused,
            dead_man_released=self.released,
            calibration_mm=None
            if calibration is None
            else [round(value * 1e3, 2) for value in calibration[:4]],
        )

    def _update_force_limit(self, reading: JoystickReading, now_ns: int) -> None:
        """Set the force limit in the application: none without the dead-man button, then a ramp."""
        self._force_restored = False
        if not reading.dead_man and not self._hands_off:
            if self._held_since_ns is not None:
                self.released += 1
            self._held_since_ns = None
            self._let_go = True
            self.force_limit_n = 0.0
            return
        if not self._let_go and not self._hands_off:
            # It was held when the application began: that is no order to move.
            self.force_limit_n = 0.0
            return
        if self._held_since_ns is None:
            self._held_since_ns = now_ns
        held_ns = now_ns - self._held_since_ns
        self._force_restored = held_ns >= _RETURN_NS
        share = min(1.0, held_ns / _RETURN_NS)
        self.force_limit_n = self._full_force_n * self.supervisor.share * share

    def handle_trouble(self, reason: str, now_ns: int) -> None:
        """An axis behind x and y measures what cannot be."""
        self._handle_health(Health.FAULT, now_ns, reason)

    def _handle_health(self, health: Health, now_ns: int, reason: str = "") -> None:
        machine, reason = self.machine, reason or self.supervisor.reason
        state = machine.state
        if health is Health.FATAL:
            if state is not JoystickState.FATAL:
                machine.handle_event(JoystickEvent.FATAL_FAULT, now_ns, reason)
        elif health is Health.FAULT:
            if state not in (JoystickState.RECOVERABLE, JoystickState.FATAL):
                machine.handle_event(JoystickEvent.FAULT, now_ns, reason)
                # The next calibration replaces this one; until then a position is no fault.
                self._forget_calibration()
        elif state in (JoystickState.APPLICATION, JoystickState.CALIBRATED):
            machine.handle_event(JoystickEvent.HALT, now_ns, reason)
        elif self._run is not None:
            machine.handle_event(JoystickEvent.CALIBRATION_FAILED, now_ns, reason)
        if machine.state is not state:
            self._end_script(reason)
            self.supervisor.expects_peer = False

    def _continue_startup(self, raw: JoystickReading, now_ns: int) -> None:
        """Outside the application: continue self-test or calibration, or make a request."""
        machine = self.machine
        state = machine.state
        self._output = IDLE
        if state is JoystickState.INIT:
            self._cycles += 1
            if self._cycles >= _SELF_TEST_CYCLES:
                machine.handle_event(JoystickEvent.SELF_TEST_PASSED, now_ns)
        elif self._run is not None:
            self._continue_calibration(self._run, raw, now_ns)
        elif self._test is not None:
            self._continue_test(self._test, raw, now_ns)
        elif self._automatic and not self.paused:
            self._request_next(state, now_ns)

    def _pause(self, event: JoystickEvent, now_ns: int, by: str) -> str:
        machine = self.machine
        if machine.state is JoystickState.FATAL:
            return self.handle_request(event, now_ns)
        self.paused = f"{event.value} {by}"
        # The controller must know before its next cycle that its force is not exerted.
        self.force_limit_n = 0.0
        if (machine.state, event) in TRANSITIONS:
            return self.handle_request(event, now_ns, by)
        # There is no force here but that of a calibration or a test.
        self._end_script(f"{event.value}: {by}")
        return ""

    def _continue_calibration(
        self, run: ScriptRun[Calibration], raw: JoystickReading, now_ns: int
    ) -> None:
        self._output = run.handle_reading(raw, now_ns)
        if (result := run.result) is None:
            return
        self._run = None
        if result.problem:
            self.machine.handle_event(JoystickEvent.CALIBRATION_FAILED, now_ns, result.problem)
        else:
            self.calibration = result
            self.device.set_zero(result.x_m, result.y_m)
            self.supervisor.set_workspace(result.half_width_m, result.half_height_m)
            self.machine.handle_event(JoystickEvent.CALIBRATION_PASSED, now_ns)

    def _continue_test(self, run: ScriptRun[TestReport], raw: JoystickReading, now_ns: int) -> None:
        self._output = run.handle_reading(raw, now_ns)
        if run.result is not None:
            self._test = None
            self.test = found = run.result._replace(number=self.test.number)
            passed = found.outcome is Outcome.PASSED
            event = JoystickEvent.TEST_PASSED if passed else JoystickEvent.TEST_FAILED
            self.machine.handle_event(event, now_ns, found.reason)

    def _end_script(self, reason: str) -> None:
        """End a calibration or a test; its force ends with the next `handle_force`."""
        if self._test is not None:
            self._test.abort()
            self.test = self.test._replace(outcome=Outcome.ABORTED, reason=reason)
        self._run = self._test = None
        self._output = IDLE

    def _forget_calibration(self) -> None:
        self.calibration = None
        self.supervisor.forget_workspace()

    def _request_next(self, state: JoystickState, now_ns: int) -> None:
        if state is JoystickState.STANDBY:
            self.handle_request(JoystickEvent.CALIBRATE, now_ns)
        elif state is JoystickState.CALIBRATED:
            self.handle_request(JoystickEvent.START, now_ns)
        elif state is JoystickState.HALTED:
            if self.supervisor.health is Health.OK:
                self.handle_request(JoystickEvent.RESUME, now_ns)
        elif (
            state in (JoystickState.CALIBRATION_ERROR, JoystickState.RECOVERABLE)
            and self._retries_left
            and now_ns - max(self.machine.since_ns, self._tried_ns) >= _RETRY_NS
        ):
            self._tried_ns = now_ns
            # A refused request is not an attempt: its cause is still there.
            if not self.handle_request(JoystickEvent.ACKNOWLEDGE, now_ns):
                self._retries += 1


def _rounded(temperature_c: float | None) -> float | None:
    return None if temperature_c is None else round(temperature_c, 1)


def _cut(force_n: float, limit_n: float) -> float:
    if not isfinite(force_n):
        return 0.0
    return limit_n if force_n > limit_n else -limit_n if force_n < -limit_n else force_n
