"""What repair does at one end of the link: it measures losses, and keeps a reserve. A core."""

from telepresence.link.link_metrics import RepairSentMetrics
from telepresence.link.receiver import LinkReceiver
from telepresence.link.repair.encoder import Idle
from telepresence.link.repair.reserve import NOTHING, PARTS, Growth, Kept, Loss, Reserve
from telepresence.link.sender import LinkSender


class EndRepair:
    """The repair of one end: what its receiver lost, and what its sender keeps free.

    on: whether both ends have repair; `set` changes it.
    compact: idle octets cost nothing on the path, so idle zones carry repair only while losses are
        reported; `set_compact` changes it. On other paths a few do without losses.
    saving: the path is too slow for repair in idle zones, and for the lowest level; `set_saving`
        changes it.
    """

    def __init__(self, sender: LinkSender, receiver: LinkReceiver) -> None:
        self._sender, self._receiver = sender, receiver
        self._reserve = Reserve()
        self._received, self._sent = Growth(), Growth()
        self._reported = Loss()
        self.on = True
        self.compact = self.saving = False
        self._use(self._reserve)

    @property
    def leave_out(self) -> int:
        """One picture of so many is to be left out; 0: none."""
        return self._kept.leave_out

    @property
    def _kept(self) -> Kept:
        return self._reserve.kept if self._sender.profile.repair == "auto" else NOTHING

    def set(self, on: bool) -> None:
        """Whether both ends have repair."""
        if on != self.on:
            self.on = on
            self._sender.set_repair(on)
            self._receiver.set_repair(on)
            self._use(Reserve())

    def set_compact(self, compact: bool) -> None:
        """Whether the path to the other end leaves idle octets out."""
        if compact != self.compact:
            self.compact = compact
            self._use(self._reserve)

    def set_saving(self, saving: bool) -> None:
        """Whether the path to the other end is too slow."""
        self.saving = self._sender.holds_maintenance = saving
        self._use(self._reserve)

    def measure(self, now_ns: int) -> Loss:
        """Return what of the peer's frames is lost, for the peer."""
        repair = self._receiver.repair
        if repair is None:
            return Loss()
        frames = self._receiver.frames_received
        return Loss.of(*self._received.since(now_ns, frames, *repair.losses))

    def handle_loss(self, loss: Loss | None, now_ns: int) -> None:
        """The peer reports what of this end's frames is lost; None: it says nothing."""
        sender = self._sender
        if loss is None or sender.repair is None:
            return
        self._reported = loss
        octets, frames = self._sent.since(now_ns, sender.idle_octets, sender.frames_sent)
        idle_share = octets / max(1, frames * sender.profile.packet_zone_octets)
        self._reserve.handle_loss(loss, idle_share, now_ns)
        self._use(self._reserve)

    def _use(self, reserve: Reserve) -> None:
        self._reserve = reserve
        self._sender.reserve = self._kept
        if self._sender.repair is not None:
            if self.saving or (self.compact and not reserve.active):
                idle = Idle.NONE
            else:
                idle = Idle.MANY if reserve.active else Idle.FEW
            self._sender.repair.set_idle(idle)

    def report(self) -> RepairSentMetrics | None:
        """Return what this end sends for repair, and why; None where the setup has no repair."""
        if self._sender.profile.repair == "off":
            return None
        if not self.on:
            mode, why = "off", "the other end does not know it"
        elif self.saving:
            mode, why = "waiting", "the path to the other end is too slow"
        elif self._reserve.active:
            mode = "reserve" if self._sender.profile.repair == "auto" else "idle"
            why = "the other end reports losses"
        elif self.compact:
            mode, why = "waiting", "no loss is reported, and the path leaves idle octets out"
        else:
            mode, why = "idle", "no loss is reported"
        return RepairSentMetrics(
            mode=mode,
            why=why,
            **self._kept._asdict(),
            lost=self._reported.lost / PARTS,
            torn=self._reported.torn / PARTS,
        )
