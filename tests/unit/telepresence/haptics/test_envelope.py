"""The rules of docs/safety.md, one by one, at the robot's side of haptics on virtual time."""

from dataclasses import fields, replace

import pytest

from kontur_av.clock import NS_PER_MS as MS
from telepresence.haptics.authority import Authority, ControlAuthority
from telepresence.haptics.bilateral import RobotSide
from telepresence.haptics.envelope import Hold, SafetyEnvelope, SafetyLimits
from telepresence.haptics.robot_controller import RobotControllerModel
from telepresence.haptics.sample import STATE_APPLICATION, STATE_HALTED, Command

LIMITS = SafetyLimits(half_width_m=0.2, half_height_m=0.2)


class Bench:
    """The envelope with a robot; `command` is what the operator sends, None for nothing."""

    def __init__(self, limits=LIMITS, **options):
        self.envelope = SafetyEnvelope(limits, **options)
        model = RobotControllerModel(speed_m_s=limits.speed_m_s, half_width_m=limits.half_width_m)
        self.side = RobotSide(model=model, envelope=self.envelope, ownership=ControlAuthority())
        self.side.link.latest = lambda now_ns: self.command
        self.now_ns = 0
        # More energy than any motion takes.
        self.command = Command(0.0, 0.0, 10_000_000, dead_man=False)

    def change(self, **changes):
        self.command = self.command._replace(**changes)
        return self

    def move(self, way_m):
        return self.change(x_m=self.command.x_m + way_m)

    def run(self, milliseconds):
        """Return how far the reference is led (m), and its greatest speed (m/s)."""
        controller, way_m, most_m = self.side.controller, 0.0, 0.0
        for _ in range(milliseconds):
            before_m = controller.reference_x_m
            if self.command is not None:
                self.change(energy_uj=self.command.energy_uj + 50_000)
            self.side.handle_cycle(self.now_ns, MS)
            self.now_ns += MS
            if not controller.holding:
                step_m = controller.reference_x_m - before_m
                way_m, most_m = way_m + step_m, max(most_m, abs(step_m))
        return way_m, most_m / 0.001

    def press(self):
        """Let the button go, and press it."""
        self.change(dead_man=False).run(20)
        self.change(dead_man=True).run(20)
        return self

    def silence(self, milliseconds):
        command, self.command = self.command, None
        moved = self.run(milliseconds)
        self.command = command
        return moved

    def holds(self, by):
        """Whether a hand that moves by 30 mm moves nothing, for this reason."""
        way_m, _ = self.move(-0.03).run(400)
        self.move(0.03)
        return way_m == 0.0 and self.envelope.hold is by and self.side.controller.holding

    def follows(self):
        self.run(20)
        way_m, _ = self.move(-0.03).run(500)
        return way_m < -0.02 and self.envelope.hold is Hold.NONE


def followed(limits=LIMITS):
    """A bench whose robot follows the hand."""
    bench = Bench(limits).press()
    assert bench.follows()
    return bench


@pytest.mark.rule("S1")
def test_s1_without_a_fresh_command_it_holds_still():
    bench = followed()
    assert bench.silence(200) == (0.0, 0.0)
    assert bench.envelope.hold is Hold.NO_COMMAND and not bench.envelope.waiting


@pytest.mark.rule("S2")
@pytest.mark.parametrize("stopped", [False, True])
def test_s2_after_a_long_drop_out_it_needs_a_new_press(stopped):
    bench = followed()
    if stopped:
        # This process did not run meanwhile, so it has seen no silence.
        bench.now_ns += 3000 * MS
    else:
        bench.silence(350)
    assert bench.holds(Hold.LOST)
    assert bench.press().follows()


def restart_of_the_joystick(bench):
    bench.side.link.session.restarts += 1


def halt(bench):
    bench.change(state=STATE_HALTED, halted=True).run(5)
    bench.change(state=STATE_APPLICATION, halted=False)


def power_off(bench):
    bench.side.robot.set_off()
    bench.run(5)
    bench.side.robot.couple()


def hand_over(bench):
    """The partner drives once the tip has rested; no energy of the owner before pays for it."""
    bench.side.ownership.handle_order(Authority.PARTNER, bench.now_ns)
    bench.run(299)
    assert bench.side.ownership.authority is None
    bench.run(200)
    assert bench.side.ownership.authority is Authority.PARTNER


INTERRUPTIONS = {
    "a restart of the joystick": (restart_of_the_joystick, Hold.JOYSTICK_STARTED),
    "a halt": (halt, Hold.INACTIVE),
    "a power off": (power_off, Hold.OFF),
    "another owner": (hand_over, Hold.OWNER),
    "another camera": (lambda bench: bench.envelope.require_press(Hold.CAMERA), Hold.CAMERA),
}


@pytest.mark.rule("S3")
@pytest.mark.parametrize("what", INTERRUPTIONS)
def test_s3_after_an_interruption_it_needs_a_new_press_and_starts_where_it_is(what):
    interrupt, cause = INTERRUPTIONS[what]
    bench = followed()
    interrupt(bench)
    assert bench.holds(cause)
    bench.move(0.1)
    position_m = bench.side.robot.x_m
    bench.press().run(200)
    assert bench.side.robot.x_m == pytest.approx(position_m, abs=0.002)
    assert bench.envelope.offset_m[0] == pytest.approx(position_m - bench.command.x_m, abs=0.002)
    assert bench.follows()


@pytest.mark.rule("S3")
def test_s3_a_robot_that_has_just_started_needs_a_press():
    bench = Bench()
    bench.change(dead_man=True)
    assert bench.holds(Hold.STARTED)
    assert bench.press().follows()
    # A press while it was off counts when it is on.
    bench = Bench()
    bench.side.robot.set_off()
    bench.run(5)
    bench.press()
    assert not bench.envelope.presses
    bench.side.robot.couple()
    assert bench.follows()


@pytest.mark.rule("S4")
def test_s4_without_the_dead_man_button_it_holds_still():
    bench = followed()
    since_s = bench.now_ns / 1e9
    bench.change(dead_man=False)
    assert bench.holds(Hold.RELEASED)
    metrics = bench.envelope.report()
    assert (metrics.hold, metrics.waiting, metrics.presses) == (Hold.RELEASED, True, 1)
    assert metrics.since_s == pytest.approx(since_s, abs=0.002)
    bench.change(dead_man=True)
    assert bench.follows()


@pytest.mark.rule("S5")
@pytest.mark.rule("S8")
@pytest.mark.parametrize("half", [False, True])
def test_s5_and_s8_an_old_picture_slows_it_and_then_holds_it(half):
    bench = followed()
    if half:
        bench.envelope.blind = True
    else:
        bench.change(blind=True)
    way_m, speed_m_s = bench.move(0.08).run(900)
    assert 0.8 * LIMITS.slow_m_s * 0.9 < way_m and speed_m_s <= LIMITS.slow_m_s * 1.001
    bench.run(300)
    assert bench.holds(Hold.PICTURE)
    # A press in the dark is none.
    assert bench.press().holds(Hold.PICTURE)
    bench.envelope.blind = False
    bench.change(blind=False)
    assert bench.holds(Hold.PICTURE)
    assert bench.press().follows()


@pytest.mark.rule("S6")
def test_s6_an_emergency_stop_latches_until_it_is_released_here_and_there():
    bench = followed()
    bench.change(stop=True).run(1)
    assert bench.envelope.stopped
    bench.change(stop=False)
    assert bench.press().holds(Hold.STOPPED)
    assert bench.envelope.handle_stop_released(bench.now_ns) == ""
    assert bench.holds(Hold.STOPPED)
    assert bench.press().follows()
    assert bench.envelope.handle_stop_released(bench.now_ns) != ""


def test_s6_a_joystick_that_still_orders_a_stop_is_not_followed():
    bench = Bench(stopped=True)
    assert bench.press().holds(Hold.STOPPED), "of an earlier life"
    bench.change(stop=True).run(1)
    assert bench.envelope.handle_stop_released(bench.now_ns) == ""
    assert bench.press().holds(Hold.STOPPED)
    assert not bench.envelope.stopped
    bench.change(stop=False)
    assert bench.press().follows()
    bench.side.robot.set_off()
    bench.change(stop=True).run(1)
    assert bench.envelope.stopped and bench.envelope.hold is Hold.STOPPED
    assert bench.envelope.stops == 1


@pytest.mark.rule("S6")
def test_s6_the_robot_knows_who_stopped_it_who_released_it_and_when():
    bench = followed()
    stop, release = bench.envelope.handle_stop, bench.envelope.handle_stop_released
    stop(bench.now_ns, "the cosmonaut")
    stop(bench.now_ns, "a terminal")
    assert bench.envelope.stopped_by == "the cosmonaut"
    release(bench.now_ns + 1, "the supervisor")
    bench.change(stop=True).run(1)
    release(bench.now_ns)
    # The joystick orders it still.
    bench.run(1)
    assert bench.envelope.stopped_by == "the joystick's end"
    bench.change(stop=False).run(1)
    assert bench.envelope.stopped_by == ""
    assert [event.what for event in bench.envelope.report().events] == [
        "emergency stop by the cosmonaut",
        "the supervisor released the emergency stop by the cosmonaut",
        "emergency stop by the joystick's end",
        "somebody released the emergency stop by the joystick's end",
    ]
    again = SafetyEnvelope(stopped=True)
    again.handle_stop(5, "the cosmonaut")
    assert (again.stopped_by, again.stops) == ("the cosmonaut", 0)
    assert again.report().events[0].at_ns == 5


@pytest.mark.rule("S7")
@pytest.mark.parametrize("lasts_ms", [30, 290])
def test_s7_after_a_short_drop_out_it_catches_up_slowly(lasts_ms):
    bench = followed()
    bench.silence(lasts_ms)
    way_m, speed_m_s = bench.move(0.08).run(300)
    assert way_m > 0.02 and speed_m_s <= LIMITS.approach_m_s * 1.001
    bench.run(800)
    assert bench.envelope.resumed == 1
    assert bench.move(-0.08).run(300)[1] > 2 * LIMITS.approach_m_s


@pytest.mark.rule("S9")
def test_s9_speed_and_workspace_have_limits():
    bench = Bench(replace(LIMITS, speed_m_s=0.2, half_width_m=0.05)).press()
    _, speed_m_s = bench.move(-0.15).run(1000)
    assert speed_m_s <= 0.2001
    assert bench.side.controller.reference_x_m == pytest.approx(-0.05, abs=1e-3)


@pytest.mark.rule("S9")
@pytest.mark.parametrize("limit_m_s", [0.03, 0.05, 0.08, 0.1, 0.2, 0.5])
def test_s9_the_tip_that_catches_up_is_no_faster_than_its_limit(limit_m_s):
    slower = min(limit_m_s, LIMITS.approach_m_s)
    limits = replace(LIMITS, speed_m_s=limit_m_s, approach_m_s=slower, slow_m_s=min(slower, 0.03))
    bench = Bench(limits).press()
    bench.move(-0.05)
    most_m_s = 0.0
    for _ in range(1500):
        bench.run(1)
        most_m_s = max(most_m_s, abs(bench.side.robot.vx_m_s))
    assert 0.9 * limit_m_s < most_m_s <= limit_m_s


@pytest.mark.rule("6")
@pytest.mark.parametrize("name", [each.name for each in fields(SafetyLimits)])
def test_limits_that_cannot_work_are_refused(name):
    for value in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(ValueError, match=name):
            SafetyLimits(**{name: value})


def test_limits_must_fit_each_other():
    for wrong in ({"resume_within_s": 0.01}, {"slow_m_s": 0.6}, {"approach_m_s": 0.6}):
        with pytest.raises(ValueError, match="take at"):
            SafetyLimits(**wrong)
