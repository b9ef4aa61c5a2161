"""The two ends of a setup's link, live and simulated."""

from kontur_av.clock import NS_PER_MS
from pipelines.setup.table import Setup
from telepresence.link.gateway import Gateway
from telepresence.link.supervision.configuration import SupervisionTiming

#: What an answer takes besides the way there and back.
_TURNAROUND_NS = 200 * NS_PER_MS


def make_gateway(
    setup: Setup, *, ground: bool, life: int, seed: int, epoch_ns: int, now_ns: int
) -> Gateway:
    """The core of one end, with the radio on its way out.

    life: 1..65535, by which the peer knows that it has another one before it.
    seed, epoch_ns: what the radio draws by, and when it begins; the same at both ends.
    """
    up = setup.uplink, setup.uplink_flows
    down = setup.downlink, setup.downlink_flows
    (transmit, sent), (receive, received) = (up, down) if ground else (down, up)
    return Gateway(
        transmit=transmit,
        transmit_flows=sent,
        receive=receive,
        receive_flows=received,
        master=ground,
        life=life,
        now_ns=now_ns,
        radio=setup.radio_path(transmit, seed=seed, epoch_ns=epoch_ns),
        timing=_timing(setup),
    )


def _timing(setup: Setup) -> SupervisionTiming:
    """With patience enough for the radio's delay."""
    longest_delay_ns = round(setup.radio_profile.longest_delay_ns)
    default = SupervisionTiming()
    return SupervisionTiming(
        round_trip_ns=max(default.round_trip_ns, 2 * longest_delay_ns + _TURNAROUND_NS)
    )
