"""The sending processes of a simulated session: encoding takes its time."""

from collections import deque
from collections.abc import Callable

from kontur_av.media import AccessUnit, CaptureStamp
from pipelines.cores.sending import VideoSending, VoiceSending
from pipelines.simulation.agenda import Agenda, Timer
from pipelines.simulation.costs import CodingCosts
from pipelines.simulation.studio import Picture
from pipelines.simulation.workers import Job, Worker
from telepresence.link.flows import Level
from telepresence.link.gateway import Gateway
from telepresence.world import WorldState


class _Sender:
    """Sends what is due, and looks for what to encode."""

    def __init__(
        self,
        stream: str,
        sending: VideoSending | VoiceSending,
        *,
        agenda: Agenda,
        gateway: Gateway,
        ntp: Callable[[int], int],
    ) -> None:
        self._rtp, self._rtcp = stream, f"{stream}_rtcp"
        self._sending = sending
        self._agenda = agenda
        self._gateway = gateway
        self._ntp = ntp
        #: Whether it is encoding.
        self._busy = False
        self._timer = Timer(agenda, self._wake)
        self.tell = sending.tell

    def _wake(self, now_ns: int) -> None:
        self._send_due(now_ns)

    def _send_due(self, now_ns: int) -> None:
        handle_datagram = self._gateway.handle_datagram
        while (packet := self._sending.poll_transmit(now_ns)) is not None:
            handle_datagram(self._rtp, packet, now_ns)
        report = self._sending.poll_report(now_ns, self._ntp)
        if report is not None:
            handle_datagram(self._rtcp, report, now_ns)
        self._timer.set(self._sending.poll_timeout(), now_ns)


class VideoSender(_Sender):
    """Encodes the newest picture when the stream's budget has room for one.

    Meanwhile packets leave: the live process encodes in a thread of its own.
    """

    def __init__(
        self,
        stream: str,
        sending: VideoSending,
        *,
        agenda: Agenda,
        gateway: Gateway,
        ntp: Callable[[int], int],
        studio: Worker,
        costs: CodingCosts,
    ) -> None:
        super().__init__(stream, sending, agenda=agenda, gateway=gateway, ntp=ntp)
        self._core = sending
        self._studio = studio
        self._cost_ns = costs.ns("encode")
        self._newest: tuple[Picture, CaptureStamp] | None = None
        self.handle_feedback = sending.handle_feedback

    def handle_picture(self, picture: Picture, stamp: CaptureStamp, now_ns: int) -> None:
        """A picture comes, and replaces the one before if that was not encoded."""
        self._newest = picture, stamp
        self._core.handle_picture(stamp, now_ns)
        self._wake(now_ns)

    def _wake(self, now_ns: int) -> None:
        self._core.handle_freed(self._gateway.freed_bps, now_ns)
        self._look(now_ns)
        self._send_due(now_ns)

    def _look(self, now_ns: int) -> None:
        if self._busy or self._newest is None:
            return
        gateway = self._gateway
        waiting_octets = gateway.sender.waiting_octets(Level.VIDEO)
        self._core.handle_link(waiting_octets, gateway.contacts, gateway.supervisor.signal, now_ns)
        coding = self._core.poll_encode(now_ns)
        if coding is None:
            return
        (picture, stamp), self._newest = self._newest, None
        self._busy = True
        job = self._studio.submit((picture, coding))
        self._agenda.at(now_ns + self._cost_ns, lambda now: self._finish(job, stamp, now))

    def _finish(self, job: Job, stamp: CaptureStamp, now_ns: int) -> None:
        data, keyframe = job.result()
        self._core.handle_freed(self._gateway.freed_bps, now_ns)
        self._core.handle_access_unit(AccessUnit(data, stamp, keyframe, now_ns))
        self._busy = False
        self._send_due(now_ns)
        self._look(now_ns)


class VoiceSender(_Sender):
    """Encodes every block of sound as it comes.

    Meanwhile nothing leaves: the live process, too, does one after the other.
    """

    def __init__(
        self,
        stream: str,
        sending: VoiceSending,
        *,
        agenda: Agenda,
        gateway: Gateway,
        ntp: Callable[[int], int],
        studio: Worker,
        costs: CodingCosts,
    ) -> None:
        super().__init__(stream, sending, agenda=agenda, gateway=gateway, ntp=ntp)
        self._core = sending
        self._studio = studio
        self._cost_ns = costs.ns("voice_encode")
        self._waiting: deque[tuple[CaptureStamp, WorldState | None]] = deque(maxlen=8)

    def handle_sound(self, stamp: CaptureStamp, state: WorldState | None, now_ns: int) -> None:
        """A block of sound is complete; state: of the world, None for a file's."""
        self._waiting.append((stamp, state))
        self._look(now_ns)

    def _wake(self, now_ns: int) -> None:
        if not self._busy:
            self._send_due(now_ns)

    def _look(self, now_ns: int) -> None:
        while self._waiting and not self._busy:
            stamp, state = self._waiting.popleft()
            if not self._core.handle_block(stamp, now_ns):
                continue
            self._busy = True
            job = self._studio.submit((stamp.sequence, now_ns, state))
            self._agenda.at(now_ns + self._cost_ns, self._finishing(job, stamp))

    def _finishing(self, job: Job, stamp: CaptureStamp) -> Callable[[int], None]:
        def finish(now_ns: int) -> None:
            self._core.handle_packet(job.result(), stamp, now_ns)
            self._busy = False
            self._send_due(now_ns)
            self._look(now_ns)

        return finish
