"""The rows for a partner who may drive the robot, or an arm of its own."""

from collections.abc import Iterable
from dataclasses import replace

from pipelines.session.setup.segments import Segment
from pipelines.session.setup.table import Setup
from pipelines.session.topology.rows import LOOP_PRIORITY, ProcessRow, Stage

#: Who is to drive, and who does: `pipelines.hand.arm_owner`.
ARM_ORDER_TOPIC = "arm/order"
ARM_STATE_TOPIC = "arm/state"
#: The arm that only a partner drives.
SECOND_ROBOT_TOPIC = "robot/second"
SECOND_ROBOT = "robot_second"
OWNER_DESK = "owner_desk"

#: By topic: one sample of it, in words.
PARTNER_SAMPLES = {
    ARM_ORDER_TOPIC: "who is to drive the robot",
    ARM_STATE_TOPIC: "who drives the robot, and refused datagrams",
    SECOND_ROBOT_TOPIC: "state of the second arm: place of the tip, force and contact",
}
#: Offsets from the base port: where the robot takes a partner's samples, and where its own go.
PARTNER_TAKEN, PARTNER_GIVEN = 7, 8


def partner_ports(setup: Setup) -> tuple[int, int]:
    """The robot's port for a partner's samples, and the partner's for the robot's; on loopback."""
    return setup.base_port + PARTNER_TAKEN, setup.base_port + PARTNER_GIVEN


def with_partner(rows: list[ProcessRow], setup: Setup) -> Iterable[ProcessRow]:
    """The rows of a session, with those that a partner's arm needs."""
    taken, _ = partner_ports(setup)
    for row in rows:
        if row.name != "robot" or setup.partner_arm != "shared":
            yield row
            continue
        yield replace(
            row,
            reads=(*row.reads, ARM_ORDER_TOPIC),
            writes=(*row.writes, ARM_STATE_TOPIC),
            ports=(*row.ports, taken),
        )
    if setup.partner_arm == "shared":
        yield ProcessRow(
            name=OWNER_DESK,
            segment=Segment.GROUND,
            stage=Stage.LINK,
            run="pipelines.hand.process_owner:run_owner_desk",
            reads=(ARM_STATE_TOPIC,),
            writes=(ARM_ORDER_TOPIC,),
            what="hands the robot over to a partner and back",
        )
    elif setup.partner_arm == "second":
        yield ProcessRow(
            name=SECOND_ROBOT,
            segment=Segment.GROUND,
            stage=Stage.LINK,
            run="pipelines.hand.partner_arm:run_second_robot",
            priority=LOOP_PRIORITY,
            writes=(SECOND_ROBOT_TOPIC,),
            ports=(taken,),
            what="1 kHz loop of the arm that a partner drives",
        )
