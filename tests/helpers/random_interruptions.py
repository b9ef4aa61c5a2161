"""Random losses, stalls, halts, changes of owner and presses at the robot, and who may move it."""

from random import Random
from typing import NamedTuple

from telepresence.haptics.envelope import Hold, SafetyEnvelope, SafetyLimits
from telepresence.haptics.robot import Robot
from telepresence.haptics.robot_controller import RobotController
from telepresence.haptics.sample import STATE_APPLICATION, STATE_HALTED, Command

MS = 1_000_000
#: Shorter than a setup's, so that a sequence needs no seconds.
LIMITS = SafetyLimits(command_max_age_s=0.001, resume_within_s=0.015, picture_hold_s=0.012)
CYCLES = 160
#: The robot has come to rest this long after it may not move any more.
_REST = 60
_REST_M_S = 0.05


class Cycle(NamedTuple):
    """What happens in one millisecond. command: None if none is fresh."""

    command: Command | None
    interruption: Hold | None = None
    stop_released: bool = False
    off: bool = False


def random_sequence(seed):
    """Return the cycles of one sequence."""
    random = Random(seed)
    # From spell to spell; most of them are short.
    spells = {"silent": 0, "pressed": 0, "halted": 0, "stop": 0, "blind": 0, "off": 0}
    likely = {
        "silent": 0.25,
        "pressed": 0.6,
        "halted": 0.15,
        "stop": 0.05,
        "blind": 0.2,
        "off": 0.1,
    }
    on = dict.fromkeys(spells, False)
    x_m = y_m = 0.0
    cycles = []
    for cycle in range(CYCLES):
        for name, until in spells.items():
            if cycle >= until:
                on[name] = random.random() < likely[name]
                spells[name] = cycle + random.choice((1, 2, 4, 8, 12, 14, 16, 20, 30, 40))
        x_m += random.uniform(-0.001, 0.001)
        y_m += random.uniform(-0.001, 0.001)
        if random.random() < 0.01:
            x_m, y_m = random.uniform(-0.1, 0.1), random.uniform(-0.1, 0.1)
        command = Command(
            x_m,
            y_m,
            # Enough energy for any motion.
            1_000_000 * (cycle + 1),
            dead_man=on["pressed"],
            state=STATE_HALTED if on["halted"] else STATE_APPLICATION,
            halted=on["halted"],
            stop=on["stop"],
            blind=on["blind"],
        )
        interruption = None
        if random.random() < 0.01:
            interruption = random.choice((Hold.OWNER, Hold.CAMERA, Hold.JOYSTICK_STARTED))
        cycles.append(
            Cycle(
                None if on["silent"] else command,
                interruption,
                stop_released=random.random() < 0.02,
                off=on["off"],
            )
        )
    return cycles


def may_move(cycles):
    """Yield for each cycle whether the rules let the hand lead. Written apart from the envelope."""
    released = pressed = False
    stopped = was_off = asserted = False
    heard = 0
    blind_since = None
    for at, cycle in enumerate(cycles):
        command = cycle.command
        broken = cycle.interruption is not None or (cycle.off and not was_off)
        broken = broken or (at - heard) * MS > 15 * MS
        was_off = cycle.off
        if cycle.stop_released and stopped:
            stopped, broken = False, True
        active = True
        if command is not None:
            heard = at
            stopped = stopped or (command.stop and not asserted)
            asserted = command.stop
            active = command.state == STATE_APPLICATION and not command.halted
            active = active and not command.stop
            if active:
                if not command.blind:
                    blind_since = None
                elif blind_since is None:
                    blind_since = at
                elif (at - blind_since) * MS >= 12 * MS:
                    broken = True
        if broken or stopped or not active:
            released = pressed = False
        if command is not None and active:
            if not command.dead_man:
                # Even now: what interrupted came before this command.
                released, pressed = True, False
            elif released and not stopped:
                pressed = True
        yield (
            command is not None
            and active
            and command.dead_man
            and pressed
            and not stopped
            and not cycle.off
        )


def run(cycles):
    """Run the robot through `cycles`; return what broke the rules, in words."""
    robot, envelope = Robot(), SafetyEnvelope(LIMITS)
    controller = RobotController()
    wrong = []
    still = 0
    for at, (cycle, allowed) in enumerate(zip(cycles, may_move(cycles), strict=True)):
        now_ns = at * MS
        if cycle.interruption is not None:
            envelope.require_press(cycle.interruption)
        if cycle.stop_released:
            envelope.handle_stop_released(now_ns)
        if cycle.off:
            robot.set_off()
            envelope.handle_off(cycle.command, now_ns)
            robot.drive(MS)
            controller.release(robot.x_m, robot.y_m)
        else:
            robot.couple()
            reference = controller.reference_x_m, controller.reference_y_m
            command = envelope.admit(cycle.command, *reference, now_ns)
            controller.speed_m_s = envelope.speed_m_s
            place = robot.x_m, robot.y_m, robot.vx_m_s, robot.vy_m_s
            robot.step(*controller.step(command, *place, MS), MS)
            step_m = max(
                abs(controller.reference_x_m - reference[0]),
                abs(controller.reference_y_m - reference[1]),
            )
            if step_m > LIMITS.speed_m_s * 0.001 + 1e-9:
                wrong.append(f"{at}: the reference jumps by {step_m * 1e3:.2f} mm")
        leads = envelope.hold is Hold.NONE
        if leads is not allowed:
            wrong.append(f"{at}: {'leads' if leads else envelope.hold}, but may move: {allowed}")
        if leads is controller.holding:
            wrong.append(f"{at}: the controller does not do what the envelope says")
        still = 0 if allowed else still + 1
        if still > _REST and max(abs(robot.vx_m_s), abs(robot.vy_m_s)) > _REST_M_S:
            wrong.append(f"{at}: it moves at {robot.vx_m_s:.3f}, {robot.vy_m_s:.3f} m/s")
    return wrong
