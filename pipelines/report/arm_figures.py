"""Who drove the robot, and a partner's own arm. A core."""

from kontur_av.clock import NS_PER_S
from pipelines.report.collector import Collector
from pipelines.report.model import ArmEventReport, ArmReport, SecondArmReport
from pipelines.session.figures import HapticCounters, OwnerGauges
from pipelines.session.topology import SECOND_ROBOT


def arm_report(collector: Collector, epoch_ns: int) -> ArmReport | None:
    """Return who drove the robot; None where only the joystick in space may.

    epoch_ns: the beginning of the session.
    """
    gauges = collector.process("robot").gauges(OwnerGauges)
    if gauges is None:
        return None
    arm = gauges.arm
    return ArmReport(
        owner=None if arm.owner is None else arm.owner.value,
        wanted=arm.wanted.value,
        waiting=arm.waiting,
        turns=arm.turns,
        refused=dict(arm.refused),
        events=[
            ArmEventReport(at_s=round((event.at_ns - epoch_ns) / NS_PER_S, 3), what=event.what)
            for event in arm.events
        ],
    )


def second_arm_report(collector: Collector) -> SecondArmReport | None:
    """Return the figures of a partner's own arm; None without one."""
    if collector.topology.setup.partner_arm != "second":
        return None
    counts = collector.process(SECOND_ROBOT).total(HapticCounters)
    return SecondArmReport(
        sent=counts.sent,
        received=counts.received,
        lost=counts.lost,
        garbage=counts.garbage,
        strays=counts.strays,
        sessions=counts.sessions,
        energy_in_uj=counts.energy_in_uj,
        energy_out_uj=counts.energy_out_uj,
    )
