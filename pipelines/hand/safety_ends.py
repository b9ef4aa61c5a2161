"""What robot and joystick do about orders that outlive a process: emergency stop, halt, power."""

from dataclasses import replace

from kontur_av.sources.stereo import HALF
from kontur_av.streams.lipsync import LAG
from kontur_av.topics.bus import TopicBus
from pipelines.hand.hand_topics import JoystickOrders, RobotOrders
from pipelines.hand.haptic_loop import Cycle
from pipelines.hand.haptics import RobotEnd
from pipelines.hand.operator_view import CameraWatch, OperatorView
from pipelines.hand.robot_desk import RobotDesk
from pipelines.media.following import Choice
from pipelines.session.orders import KeptOrders
from pipelines.session.setup.table import STEREO, Setup
from pipelines.session.topology import HALVES_TOPIC, JOYSTICK, ROBOT, SELECTED_TOPIC, Topology
from telepresence.haptics.device.handle import OperatedHandle
from telepresence.haptics.envelope import Hold, SafetyLimits
from telepresence.haptics.robot import RobotFacts
from telepresence.tasks.definitions import ControlMode

#: Of a robot that does not know what was ordered, and of such a joystick.
UNKNOWN_ROBOT = RobotOrders(powered=False, mode=ControlMode.TELEPRESENCE.value)
UNKNOWN_JOYSTICK = JoystickOrders(paused=True)


def within(limits: SafetyLimits, facts: RobotFacts | None) -> SafetyLimits:
    """Return a setup's limits, where a user's robot has less its own."""
    if facts is None:
        return limits
    speed_m_s = min(limits.speed_m_s, facts.speed_m_s)
    return replace(
        limits,
        speed_m_s=speed_m_s,
        approach_m_s=min(limits.approach_m_s, speed_m_s),
        slow_m_s=min(limits.slow_m_s, speed_m_s),
        force_n=min(limits.force_n, facts.force_limit_n),
        half_width_m=min(limits.half_width_m, facts.half_width_m),
        half_height_m=min(limits.half_height_m, facts.half_height_m),
    )


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
    """Return what keeps a person's orders, and puts the emergency stop into every sample."""
    operation = handle.operation
    last = JoystickOrders(paused=operation.paused, experiment=operation.experiment)

    def keep(_now_ns: int) -> None:
        nonlocal last
        handle.stop = kept.stopped
        orders = JoystickOrders(paused=operation.paused, experiment=operation.experiment)
        if orders != last:
            last = orders
            kept.keep(JOYSTICK, orders)

    return keep


def look_at_picture(bus: TopicBus, topology: Topology, handle: OperatedHandle) -> Cycle:
    """Return what tells the robot, in every sample, that the operator's picture is too old."""
    setup = topology.setup
    view = OperatorView(setup)
    reader = bus.reader(topology.video(setup.uplink_video.name).lag_topic)

    def look(now_ns: int) -> None:
        if (lag := reader.latest_octets()) is not None:
            view.handle_shown(*LAG.unpack(lag))
        handle.blind = view.is_blind(now_ns)

    return look


def watch_camera(bus: TopicBus, setup: Setup, end: RobotEnd) -> Cycle:
    """Return what holds the robot at a change of the camera, and at half a frozen picture."""
    envelope = end.envelope
    stale_ns = setup.stale_after_ns(setup.uplink_video)
    watch = CameraWatch(STEREO, stale_ns, lambda: envelope.require_press(Hold.CAMERA))
    choices = bus.reader(SELECTED_TOPIC)
    halves = bus.reader(HALVES_TOPIC) if STEREO in setup.cameras else None

    def look(now_ns: int) -> None:
        if (choice := choices.latest_octets()) is not None:
            watch.handle_choice(Choice.unpack(choice).camera)
        if halves is not None and (half := halves.latest_octets()) is not None:
            watch.handle_halves(HALF.unpack(half)[0])
        envelope.blind = watch.is_blind(now_ns)

    return look
