"""Any octets on a topic of a mission: a message, or ProtocolError; nothing harms its reader."""

from random import Random

import msgspec
from common import first_seed, repeats
from mutated_octets import mutate

from kontur_av.errors import ProtocolError
from pipelines.hand.robot_commands import RobotCommands
from pipelines.session import mission_messages as messages
from pipelines.session.mission_messages import LedsShown, RobotCommand, RobotOrder
from pipelines.session.topic import Topic
from telepresence.haptics.bilateral import RobotSide
from telepresence.haptics.loop import robot_link
from telepresence.tasks.definitions import ControlMode, Pattern
from telepresence.tasks.panel_picture import PanelPicture
from telepresence.tasks.positions import lights_of

MS = 1_000_000
PLACE = {"x_m": 0.0, "y_m": 0.1, "push_n": 2.0, "goal_m": (0.0, 0.1)}
ROBOT = messages.RobotStatus(
    boot_id=1, powered=True, mode=ControlMode.POSITION, fault="fünf", commanded=3, **PLACE
)
PANEL = messages.PanelShown(
    mode="hold", task="aiming", run=1, text="Aim.", words="", start_m=(0, 0), held_s=0.5
)
EXPERIMENT = messages.ExperimentShown(
    phase="idle",
    task="",
    run=2,
    elemop="",
    panel="wait_task",
    tasks=(messages.TaskListed("aiming", "Aim."), messages.TaskListed("line", "Trace.")),
    steps=(messages.StepShown(5, 1, "aiming", "selected"),),
    runs=(messages.RunShown("aiming", 1, "finished", "", 12.5),),
)
SEEDS = [
    messages.CameraRequest(1, "stereo"),
    RobotOrder(1, "power", on=True),
    RobotOrder(2, "mode", mode=ControlMode.IMPEDANCE),
    RobotOrder(3, "move", x_m=0.02, y_m=-0.01),
    RobotOrder(4, "reset"),
    RobotCommand(1, "set_mode", ControlMode.TORQUE),
    ROBOT,
    PANEL,
    EXPERIMENT,
    LedsShown.of(PanelPicture(Pattern.LEDS, 5)),
    LedsShown.of(PanelPicture(Pattern.SPOT, spot_m=(0.1, 0.0))),
]


TOPICS = {topic.type: topic for topic in vars(messages).values() if isinstance(topic, Topic)}


def pack(message):
    return TOPICS[type(message)].pack(message)


def unpack(kind, octets):
    return TOPICS[kind].unpack(octets)


def read(kind, octets):
    """The message, or None; what is read packs, and is read as the same again."""
    try:
        message = unpack(kind, octets)
    except ProtocolError:
        return None
    packed = pack(message)
    # Compared as octets, because NaN is not equal to itself.
    assert pack(unpack(kind, packed)) == packed
    return message


def test_mutated_messages_are_read_or_refused_and_harm_nobody():
    random, mutations, taken = Random(first_seed()), repeats(4000), 0
    service = RobotCommands(RobotSide(link=robot_link(boot_id=1)), boot_id=1, tasks=True, now_ns=0)
    for count in range(mutations):
        seed, other = random.choice(SEEDS), random.choice(SEEDS)
        octets = mutate(random, pack(seed))
        # As what it is, and as what it is not.
        read(type(other), octets)
        message = read(type(seed), octets)
        taken += message is not None
        if isinstance(message, RobotOrder):
            service.handle_order(message, count, count * MS)
        elif isinstance(message, RobotCommand):
            service.handle_command(message, count, count)
        elif isinstance(message, LedsShown):
            lights_of(message.picture)
        service.step(count * MS)
        assert service.control.fault == "" and isinstance(service.control.mode, ControlMode)
    assert 0.03 * mutations < taken < mutations


def test_seeds_are_read_as_they_were_and_what_is_no_message_is_refused():
    for seed in SEEDS:
        assert read(type(seed), pack(seed)) == seed
        fields = msgspec.msgpack.decode(pack(seed))
        packed = b"".join(map(msgspec.msgpack.encode, fields))
        # One field more, with lists in lists without end.
        deep = b"\xdc" + (len(fields) + 1).to_bytes(2, "big") + packed + b"\x91" * 12_000
        for octets in (b"", b"\xc0", b"\x90", b"\x92\xff\xff", b"\xa1\xff", deep):
            assert read(type(seed), octets) is None
