"""Passivity in the time domain: what has flowed through a port, and what it may still give out.

The network between hand and robot has two ports. At each, the energy is split by the sign of the
power: what flows into the network and what flows out of it. Each end tells the other by a running
total what it has granted; out of a port may flow what the other one has granted, and no more. Then
all energy that leaves the network has entered it before, whatever the delay, and each end can see
to its half of that alone (J. Artigas, C. Preusche, G. Hirzinger, "Time domain passivity for delayed
haptic telepresence with energy reference", IROS 2007; J.-H. Ryu, J. Artigas, C. Preusche, "A
passive bilateral control scheme for a teleoperator with time-varying communication delay",
Mechatronics 20, 2010; J. Artigas et al., "Kontur-2: force-feedback teleoperation from the
International Space Station", ICRA 2016).

Two things here go beyond the papers. A port keeps the first of what flows in for itself, until it
has a small reserve; only the rest is granted. So a hand that rests against a wall is not left
without force, and no joule is spent twice. And credit has a limit: what lies beyond is forgotten
(dissipated), or an hour of free motion would pay for a minute of instability.
"""

from math import inf

from telepresence.haptics.sample import ENERGY_MODULUS_UJ

_UJ_PER_J = 1e6
_J_PER_UJ = 1e-6
_MASK = ENERGY_MODULUS_UJ - 1
_NS_PER_S = 1e9


class Port:
    """The energies of one port (J), and the credit that it may give out.

    in_j, out_j: what has flowed into the network here, and out of it; both only grow.
    granted_j: what of `in_j` the peer may give out. kept_j: what of it this port may give out.
    received_j: what the peer's totals have brought. forgotten_j: credit beyond the limit.
    returned_j: credit that was granted to the peer again. credit_j: received + kept - forgotten -
    returned - out: the passivity observer of this port. least_j: the least it ever was.
    refused: totals that no peer could have reached in the time: no credit.

    reserve_j: up to this much credit is kept of what flows in. limit_j: more credit is forgotten.
    peer_power_w, patience_ns: the peer can't have taken in more than this power gives in the time
    since its last total and so much more, which is what the path may compress the time by.
    """

    def __init__(
        self,
        *,
        reserve_j: float = 0.004,
        limit_j: float = 0.5,
        peer_power_w: float = 60.0,
        patience_ns: int = 100_000_000,
    ) -> None:
        self.reserve_j = reserve_j
        self.limit_j = limit_j
        self.peer_power_w = peer_power_w
        self.patience_ns = patience_ns
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
        self._total_uj: int | None = None
        self._silent_ns = 0

    @classmethod
    def observing(cls) -> "Port":
        """One that only observes: it keeps nothing and forgets nothing."""
        return cls(reserve_j=-inf, limit_j=inf)

    @property
    def granted_uj(self) -> int:
        """The running total for the peer (µJ), rounded down."""
        return int(self.granted_j * _UJ_PER_J)

    def handle_flow(self, energy_j: float) -> None:
        """`energy_j` has flowed out of the network here; in, if it is negative."""
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
        """The newest sample of the peer says `total_uj` (0..2^32-1); `dt_ns` have passed.

        The first total is where counting begins. So is one that the peer can't have reached in
        the time: it began anew, or it is garbage.
        """
        silent_ns = self._silent_ns + dt_ns
        self._silent_ns = 0
        before_uj = self._total_uj
        if total_uj == before_uj:
            return
        self._total_uj = total_uj
        if before_uj is None:
            return
        gained_uj = (total_uj - before_uj) & _MASK
        most_j = self.peer_power_w * (silent_ns + self.patience_ns) / _NS_PER_S
        gained_j = gained_uj * _J_PER_UJ
        # After a silence in which the total may have wrapped nothing can be said about it.
        if gained_j > most_j or most_j >= ENERGY_MODULUS_UJ * _J_PER_UJ:
            self.refused += 1
            return
        self.received_j += gained_j
        self.credit_j = credit = self.credit_j + gained_j
        if credit > self.limit_j:
            self.forgotten_j += credit - self.limit_j
            self.credit_j = self.limit_j

    def give_back(self, energy_j: float) -> None:
        """So much of the credit is not needed here: the peer may give it out."""
        self.credit_j -= energy_j
        self.returned_j += energy_j
        self.granted_j += energy_j

    def handle_silence(self, dt_ns: int) -> None:
        """`dt_ns` have passed without a fresh sample."""
        self._silent_ns += dt_ns

    def handle_restart(self) -> None:
        """The peer began anew: its next total is where counting begins."""
        self._total_uj = None


class PortFigures:
    """What both controllers tell of their port; all energies in µJ."""

    port: Port
    acted: int

    @property
    def energy_in_uj(self) -> int:
        """What has flowed into the network here."""
        return int(self.port.in_j * _UJ_PER_J)

    @property
    def energy_out_uj(self) -> int:
        """What has flowed out of the network here."""
        return int(self.port.out_j * _UJ_PER_J)

    @property
    def granted_uj(self) -> int:
        """What the peer has been granted: the total that goes into the samples."""
        return self.port.granted_uj

    @property
    def credit_uj(self) -> float:
        """What may still flow out here."""
        return self.port.credit_j * _UJ_PER_J

    @property
    def observed_uj(self) -> float:
        """The passivity observer: the credit. Below 0 the port has given what nobody granted."""
        return self.port.credit_j * _UJ_PER_J

    @property
    def least_observed_uj(self) -> float:
        """The least that the observer ever said."""
        return self.port.least_j * _UJ_PER_J
