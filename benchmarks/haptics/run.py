"""One run of a cell on virtual time: both sides, and a channel in each direction. A core."""

import numpy as np

from benchmarks.haptics.cell import Cell
from benchmarks.haptics.channel import SampleChannel
from benchmarks.haptics.figures import CellFigures, Trace, figures
from benchmarks.haptics.hands import HANDS
from benchmarks.haptics.plan import CellPlan, plan
from kontur_av.clock import NS_PER_MS
from telepresence.haptics.bilateral import HeldJoystick, JoystickSide, RobotSide
from telepresence.haptics.board import Board, WallModel
from telepresence.haptics.hand import Hand


def run_cell(cell: Cell, *, seconds: float, seed: int, passive: bool) -> tuple[CellFigures, Trace]:
    """Run hand, joystick, robot and wall as planned for `seconds`.

    passive: with the passivity controllers.
    """
    planned = plan(cell, seconds)
    joystick_handle = HeldJoystick(hand=Hand(HANDS[cell.hand].model, script=planned.script))
    joystick_side = JoystickSide(passive=passive, handle=joystick_handle)
    robot_side = RobotSide(passive=passive, board=Board(WallModel(stiffness_n_m=cell.wall)))
    trace = _run(cell, planned, seed, joystick_side, joystick_handle, robot_side)
    acted = joystick_side.controller.acted, robot_side.controller.acted
    return figures(cell, planned, trace, passive=passive, acted=acted), trace


def _run(
    cell: Cell,
    planned: CellPlan,
    seed: int,
    joystick_side: JoystickSide,
    handle: HeldJoystick,
    robot_side: RobotSide,
) -> Trace:
    down = _channel(cell, f"{seed} {cell.name} down", planned.down_dark)
    up = _channel(cell, f"{seed} {cell.name} up", planned.up_dark)
    robot, controller = robot_side.robot, robot_side.controller
    joystick_port, robot_port = joystick_side.controller.port, controller.port
    rows = np.empty((planned.end_ns // NS_PER_MS, 14))
    for number, row in enumerate(rows):
        now_ns = number * NS_PER_MS
        while (data := down.poll_transmit(now_ns)) is not None:
            robot_side.handle_datagram(data, now_ns)
        while (data := up.poll_transmit(now_ns)) is not None:
            joystick_side.handle_datagram(data, now_ns)
        robot_side.handle_cycle(now_ns, NS_PER_MS)
        joystick_side.handle_cycle(now_ns, NS_PER_MS)
        if (command := joystick_side.poll_transmit(now_ns)) is not None:
            down.handle_datagram(command, now_ns)
        if (feedback := robot_side.poll_transmit(now_ns)) is not None:
            up.handle_datagram(feedback, now_ns)
        row[:] = (
            *(handle.x_m, handle.y_m, handle.motor_x_n, handle.motor_y_n),
            *(robot.x_m, robot.y_m, robot_side.force_x_n, robot_side.force_y_n),
            *(robot.force_n, joystick_port.credit_j, robot_port.credit_j),
            *(handle.work_j, robot.work_j, joystick_side.controller.damping_n_s_m),
        )
    return Trace(
        handle=rows[:, 0:2],
        displayed=rows[:, 2:4],
        tip=rows[:, 4:6],
        drive=rows[:, 6:8],
        contact_n=rows[:, 8],
        joystick_observed_j=rows[:, 9],
        robot_observed_j=rows[:, 10],
        joystick_given_j=rows[:, 11],
        robot_given_j=rows[:, 12],
        damping_n_s_m=rows[:, 13],
    )


def _channel(cell: Cell, seed: str, dark: tuple[tuple[int, int], ...]) -> SampleChannel:
    return SampleChannel(
        seed=seed,
        delay_ns=round(cell.delay / 2.0 * NS_PER_MS),
        jitter_ns=round(cell.jitter * NS_PER_MS),
        loss=cell.loss / 100.0,
        burst=cell.burst,
        dark=dark,
    )
