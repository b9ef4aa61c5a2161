"""What robot and joystick do about orders that outlive a process: emergency stop, halt, power."""

from pipelines.hand.hand_topics import JoystickOrders, RobotOrders
from pipelines.hand.haptic_loop import Cycle
from pipelines.hand.haptics import RobotEnd
from pipelines.hand.robot_desk import RobotDesk
from pipelines.session.orders import KeptOrders
from pipelines.session.topology import JOYSTICK, ROBOT
from telepresence.haptics.device.handle import OperatedHandle
from telepresence.tasks.definitions import ControlMode

#: Of a robot that does not know what was ordered, and of such a joystick.
UNKNOWN_ROBOT = RobotOrders(powered=False, mode=ControlMode.TELEPRESENCE.value)
UNKNOWN_JOYSTICK = JoystickOrders(paused=True)


def follow_stop(kept: KeptOrders, end: RobotEnd) -> Cycle:
    """Return what joins the robot's emergency stop with the one that the machine keeps."""
    envelope = end.envelope
    known = False

    def follow(now_ns: int) -> None:
        nonlocal known
        ordered = kept.stopped
        if ordered and not known:
            envelope.handle_stop(now_ns)
        elif known and not ordered:
            envelope.handle_stop_released(now_ns)
        elif envelope.stopped and not ordered:
            kept.stop("the joystick or a telecommand")
            ordered = True
        elif ordered and not envelope.stopped:
            # By a telecommand.
            kept.release()
            ordered = False
        known = ordered

    return follow


def keep_robot(kept: KeptOrders, desk: RobotDesk) -> Cycle:
    """Return what keeps power and mode of the robot."""
    last = desk.orders

    def keep(_now_ns: int) -> None:
        nonlocal last
        orders = desk.orders
        if orders != last:
            last = orders
            kept.keep(ROBOT, orders)

    return keep


def keep_joystick(kept: KeptOrders, handle: OperatedHandle) -> Cycle:
    """Return what keeps a person's halt, and puts the emergency stop into every sample."""
    last = JoystickOrders(paused=handle.operation.paused)

    def keep(_now_ns: int) -> None:
        nonlocal last
        handle.stop = kept.stopped
        orders = JoystickOrders(paused=handle.operation.paused)
        if orders != last:
            last = orders
            kept.keep(JOYSTICK, orders)

    return keep
