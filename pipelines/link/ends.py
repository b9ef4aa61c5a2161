"""The two ends of a setup's link, live and simulated."""

from kontur_av.clock import NS_PER_MS
from pipelines.session.setup.table import Setup
from pipelines.session.topology import Segment, Topology
from telepresence.link.gateway import Gateway
from telepresence.link.supervision.configuration import SupervisionTiming

#: The time for an answer, without the radio's delay there and back.
_TURNAROUND_NS = 200 * NS_PER_MS


def make_gateway(
    topology: Topology,
    segment: Segment,
    *,
    life: int,
    secret: int,
    seed: int,
    epoch_ns: int,
    now_ns: int,
    told_offset_ns: int | None = None,
) -> Gateway:
    """The core of one end, with the radio on its way out.

    life: 1 to 65535; another value tells the peer that this end has restarted.
    secret: a random number, by which the peer's answers are known; nobody else may know it.
    seed, epoch_ns: the seed and the start of the radio; the same at both ends.
    told_offset_ns: as of `Gateway`, for a peer on another machine.
    """
    setup = topology.setup
    out, back = segment.transmits, segment.peer.transmits
    transmit = topology.link(out).profile
    return Gateway(
        transmit=transmit,
        transmit_flows=topology.flows(out),
        receive=topology.link(back).profile,
        receive_flows=topology.flows(back),
        master=segment is Segment.GROUND,
        life=life,
        secret=secret,
        now_ns=now_ns,
        radio=setup.radio_path(transmit, seed=seed, epoch_ns=epoch_ns),
        timing=_timing(setup),
        told_offset_ns=told_offset_ns,
    )


def _timing(setup: Setup) -> SupervisionTiming:
    """Return a timing that allows for the radio's delay."""
    longest_delay_ns = round(setup.radio_profile.longest_delay_ns)
    default = SupervisionTiming()
    return SupervisionTiming(
        round_trip_ns=max(default.round_trip_ns, 2 * longest_delay_ns + _TURNAROUND_NS)
    )
