"""Time-domain passivity: the energy that flowed through a port, and the energy it may give out.

At each port, energy is split by the sign of the power into energy that enters the network and
energy that leaves it. Each end sends a running total of the energy it has granted to the other. A
port may give out only what the other end has granted. docs/haptics.md says why that suffices.

Sources: J. Artigas, C. Preusche, G. Hirzinger, "Time domain passivity for delayed haptic
telepresence with energy reference", IROS 2007; J.-H. Ryu, J. Artigas, C. Preusche, "A passive
bilateral control scheme for a teleoperator with time-varying communication delay", Mechatronics 20,
2010. The reserve and the limit of the credit are additions to the papers: without the limit, an
hour of free motion would pay for a minute of instability.
"""

from math import inf

from telepresence.haptics.haptic_metrics import PortMetrics

_UJ_PER_J = 1e6
_J_PER_UJ = 1e-6
_NS_PER_S = 1e9
#: A token bucket bounds how fast totals may grow: it fills with this power (W), and holds
#: what flows in this time (s), because a path may compress time.
_PEER_POWER_W, _BUCKET_S = 60.0, 0.1
_BUCKET_J = _PEER_POWER_W * _BUCKET_S


class Port:
    """The energies of one port (J), and the credit that it may give out.

    in_j, out_j: energy that entered and left the network here; both only grow.
    granted_j: the part of `in_j` that the peer may give out.
    kept_j: the part of `in_j` that this port may give out.
    received_j: credit from the peer's totals.
    forgotten_j: credit dropped above the limit, or discarded.
    returned_j: credit granted back to the peer.
    credit_j: received + kept - forgotten - returned - out, the passivity observer of this port.
    least_j: lowest value of `credit_j` so far.
    refused: totals that no peer could have reached in the time, or that fell; they give no credit.

    reserve_j: incoming energy is kept until the credit reaches this value.
    limit_j: credit above this value is dropped.
    """

    def __init__(self, *, reserve_j: float = 0.004, limit_j: float = 0.5) -> None:
        self.reserve_j = reserve_j
        self.limit_j = limit_j
        self.in_j = 0.0
        self.out_j = 0.0
        self.granted_j = 0.0
        self.kept_j = 0.0
        self.received_j = 0.0
        self.forgotten_j = 0.0
        self.returned_j = 0.0
        self.credit_j = 0.0
        self.least_j = 0.0
        self.refused = 0
        #: The highest total that gave credit, and the last one looked at.
        self._counted_uj: int | None = None
        self._total_uj: int | None = None
        #: What the token bucket holds. While no total is accepted, it fills beyond its depth.
        self._bucket_j = _BUCKET_J

    @classmethod
    def observing(cls) -> "Port":
        """Return a port that only observes: it keeps nothing and has no limit."""
        return cls(reserve_j=-inf, limit_j=inf)

    @property
    def granted_uj(self) -> int:
        """The running total for the peer (µJ), rounded down."""
        return int(self.granted_j * _UJ_PER_J)

    def handle_flow(self, energy_j: float) -> None:
        """Count `energy_j` that left the network here, or entered it if negative."""
        if energy_j > 0.0:
            self.out_j += energy_j
            self.credit_j = credit = self.credit_j - energy_j
            if credit < self.least_j:
                self.least_j = credit
        elif energy_j < 0.0:
            self.in_j -= energy_j
            lack = self.reserve_j - self.credit_j
            if lack <= 0.0:
                self.granted_j -= energy_j
            elif lack >= -energy_j:
                self.kept_j -= energy_j
                self.credit_j -= energy_j
            else:
                self.kept_j += lack
                self.credit_j += lack
                self.granted_j -= energy_j + lack

    def handle_total(self, total_uj: int, dt_ns: int) -> None:
        """Take the total (µJ) of all that the peer granted, as heard so far; `dt_ns` have passed.

        The first total only starts the count. A total counts as far as it is above the highest one
        before. One that rises faster than the peer's power is left until there was time for it.
        """
        self._bucket_j += _PEER_POWER_W * dt_ns / _NS_PER_S
        counted_uj = self._counted_uj
        if counted_uj is None:
            self._counted_uj = self._total_uj = counted_uj = total_uj
        gained_j = (total_uj - counted_uj) * _J_PER_UJ
        if not 0.0 <= gained_j <= self._bucket_j:
            if total_uj != self._total_uj:
                self._total_uj = total_uj
                self.refused += 1
            return
        self._counted_uj = self._total_uj = total_uj
        left_j = self._bucket_j - gained_j
        self._bucket_j = left_j if left_j < _BUCKET_J else _BUCKET_J
        if gained_j == 0.0:
            return
        self.received_j += gained_j
        self.credit_j = credit = self.credit_j + gained_j
        if credit > self.limit_j:
            self.forgotten_j += credit - self.limit_j
            self.credit_j = self.limit_j

    def return_credit(self, energy_j: float) -> None:
        """Grant `energy_j` of this port's credit back to the peer."""
        self.credit_j -= energy_j
        self.returned_j += energy_j
        self.granted_j += energy_j

    def discard_credit(self, energy_j: float) -> None:
        """Count `energy_j` of this port's credit as dissipated; nobody gives it out."""
        self.credit_j -= energy_j
        self.forgotten_j += energy_j

    def handle_silence(self, dt_ns: int) -> None:
        """`dt_ns` have passed without a fresh sample."""
        self._bucket_j += _PEER_POWER_W * dt_ns / _NS_PER_S


class PortController:
    """Base of both controllers. acted: how often the credit bounded what they do."""

    port: Port
    acted: int

    @property
    def credit_uj(self) -> float:
        """Energy that may still leave here. Below 0 the port gave out more than was granted."""
        return self.port.credit_j * _UJ_PER_J

    def report(self) -> PortMetrics:
        """Return the energies of the port (µJ), and the counts of what this controller did."""
        port = self.port
        return PortMetrics(
            energy_in_uj=int(port.in_j * _UJ_PER_J),
            energy_out_uj=int(port.out_j * _UJ_PER_J),
            granted_uj=port.granted_uj,
            credit_uj=round(self.credit_uj),
            least_uj=round(port.least_j * _UJ_PER_J),
            passivity_acted=self.acted,
            totals_refused=port.refused,
        )
