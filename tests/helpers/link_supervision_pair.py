"""Two ends of supervision on virtual time, and a path between them that can fail in any way."""

from collections import deque
from random import Random

from telepresence.link.flows import tmtc_flow, video_flow, voice_flow
from telepresence.link.profile import DOWNLINK, UPLINK
from telepresence.link.supervision.message import (
    Configuration,
    LinkState,
    MessageKind,
    SupervisionMessage,
)
from telepresence.link.supervision.record import PeerDoubted
from telepresence.link.supervision.supervisor import Encounter, Supervisor

MS = 1_000_000
S = 1000
UP = [tmtc_flow("tc"), voice_flow("voice"), video_flow("video")]
DOWN = [tmtc_flow("tm"), video_flow("video")]
GROUND = Configuration(transmit=UPLINK, transmit_flows=UP, receive=DOWNLINK, receive_flows=DOWN)
SPACE = Configuration(transmit=DOWNLINK, transmit_flows=DOWN, receive=UPLINK, receive_flows=UP)


def alive(**fields):
    """A message of a slave that has a signal and fresh data."""
    flags = {"master": False, "signal": True, "application": False, "fresh": True, "sending": False}
    kind = {"kind": MessageKind.ALIVE, "state": LinkState.APPROVE}
    return SupervisionMessage(**{**kind, **flags, **fields})


class End:
    """A supervisor with a minimal gateway: application data in each slot, if there is any.

    It tells streams apart by the start of the end that sent a frame.
    """

    def __init__(self, name, configuration, *, master):
        self.name, self.configuration, self.master = name, configuration, master
        self.supervisor = None
        self.boot_id = 0
        #: The boot id followed, and the unknown sender's: boot id, first and last frame, count.
        self.followed = None
        self.unknown = (None, 0, 0, 0)
        self.sends = True
        #: Interval of the slots with application data.
        self.period = 1
        #: Since it was started.
        self.events, self.sent = [], []
        self.delivered = []

    def start(self, boot_id, slot):
        self.boot_id = boot_id
        self.followed, self.events, self.sent = None, [], []
        self.supervisor = Supervisor(
            master=self.master,
            configuration=self.configuration,
            boot_id=boot_id,
            now_ns=slot * MS,
            secret=boot_id,
        )
        self.supervisor.handle_local_check(None, slot * MS)

    def of(self, kind):
        return [event for event in self.events if isinstance(event, kind)]


class Pair:
    """Ground is the master. `up` and `down` say for each slot whether its frame arrives."""

    def __init__(self, *, delay_slots=5, ground=GROUND, space=SPACE, masters=(True, False)):
        self.ground = End("ground", ground, master=masters[0])
        self.space = End("space", space, master=masters[1])
        self.ends = (self.ground, self.space)
        self.delay_slots = delay_slots
        self.paths = {"ground": deque(), "space": deque()}
        self.blocked = {"ground": False, "space": False}
        self.message_loss = 0.0
        self.garble = 0.0
        self.random = Random(1)
        self.slot = 0
        self.never_connected = False

    def start(self):
        self.ground.start(0x1111, self.slot)
        self.space.start(0x2222, self.slot)

    def run(self, slots):
        for _ in range(slots):
            self.step()
        return self

    def step(self):
        slot, now_ns = self.slot, self.slot * MS
        for end in self.ends:
            if end.supervisor is not None:
                self.transmit(end, slot, now_ns)
        for end, other in (self.ends, self.ends[::-1]):
            path = self.paths[end.name]
            while path and path[0][0] <= slot:
                _, boot_id, message, data = path.popleft()
                if other.supervisor is not None:
                    self.arrive(other, boot_id, message, data, now_ns + MS // 3)
        self.slot += 1
        both = [end.supervisor and end.supervisor.state for end in self.ends]
        assert not (self.never_connected and LinkState.CONNECTED in both)

    def arrive(self, end, boot_id, message, data, now_ns):
        supervisor = end.supervisor
        if boot_id != end.followed:
            known, begun_ns, last_ns, frames = end.unknown
            if known != boot_id or now_ns - last_ns >= 50 * MS:
                begun_ns, frames = now_ns, 0
            end.unknown = (boot_id, begun_ns, now_ns, frames + 1)
            found = supervisor.handle_unknown_sender(
                message, now_ns, frames=frames + 1, lasts_ns=now_ns - begun_ns
            )
            self.drain(end)
            if found is Encounter.IGNORE:
                return
            end.followed = boot_id
        supervisor.handle_frame(now_ns)
        if message is not None:
            supervisor.handle_message(message, now_ns)
        if data is not None and supervisor.delivering:
            end.delivered.append((now_ns, data))
            supervisor.handle_application(now_ns)
        self.drain(end)

    def transmit(self, end, slot, now_ns):
        data = None
        if end.sends and slot % end.period == 0:
            data = (end.boot_id, slot)
            end.supervisor.handle_application_sent(now_ns)
        message = end.supervisor.poll_transmit(now_ns)
        self.drain(end)
        if message is not None:
            end.sent.append((slot, message))
            if self.random.random() < self.message_loss:
                message = data = None
            elif self.random.random() < self.garble:
                message = self.random.randbytes(12)
        if not self.blocked[end.name]:
            self.paths[end.name].append((slot + self.delay_slots, end.boot_id, message, data))

    @staticmethod
    def drain(end):
        while event := end.supervisor.next_event():
            end.events.append(event)
            if isinstance(event, PeerDoubted):
                end.followed = None

    @property
    def states(self):
        return tuple(end.supervisor.state.name for end in self.ends)

    def history(self, end):
        report = end.supervisor.report(self.slot * MS)
        return [entry["to"] for entry in report.history]


CONNECTED = ("CONNECTED", "CONNECTED")


def connected(**options):
    pair = Pair(**options)
    pair.start()
    pair.run(4 * pair.delay_slots + 100)
    assert pair.states == CONNECTED
    return pair
