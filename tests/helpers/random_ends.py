"""A page's hand, joystick, channel and robot on virtual time, interrupted at random.

The person moves all the time, and lets go of the dead-man button at random, not when something
happens. The path may be late by up to 10 s. The judge knows when an interruption began, when the
button went down, and when the hand gave the newest command at the robot; nothing of the safety
envelope.
"""

from collections import deque
from math import cos, hypot, pi, sin
from random import Random

from telepresence.haptics.bilateral import JoystickSide, RobotSide
from telepresence.haptics.device.handle import OperatedHandle
from telepresence.haptics.device.page import PageDevice, PageInput
from telepresence.haptics.device.states import JoystickEvent
from telepresence.haptics.envelope import Hold, SafetyEnvelope, SafetyLimits
from telepresence.haptics.loop import joystick_link, robot_link
from telepresence.link.path.order import FrameOrder
from telepresence.link.radio import Network
from telepresence.link.radio.network import NetworkPath

MS = 1_000_000
LIMITS = SafetyLimits()
#: The robot has come to rest this long after the hand may not move it any more.
SETTLES_MS = 300
MOVES_M_S = 0.05
#: Missing commands are an interruption from here on.
GAP_MS = round(LIMITS.resume_within_s * 1000) + 1
DEEDS = (
    *("lost", "lost", "stop robot", "stop joystick", "kill robot", "kill joystick"),
    *("halt", "emergency", "blind", "owner", "camera"),
)
#: In every second session the path is late more often than anything else happens.
LATE_DEEDS = (*DEEDS, *["late"] * 2 * len(DEEDS))
#: Older commands move nothing: beyond the limit, the robot knows of it after two of its probes.
OLD_MS = round(LIMITS.hand_max_age_s * 1000) + 300
#: The latest of a late path, with its queue.
LATEST_MS = 20_000
#: Datagrams that a socket holds for an end that is stopped.
SOCKET_DEPTH = 277


class Ends:
    """One session. `run` returns what the robot did that nobody ordered, in words."""

    gap_ms = GAP_MS

    def __init__(self, seed):
        self.random = Random(seed)
        self.now_ms = 0
        self.deeds = LATE_DEEDS if seed % 2 else DEEDS
        self.delay_ms = self.random.choice((5, 20, 60, 150))
        self.down, self.up = deque(), deque()
        self.lives = 1
        self.paused = ""
        self.stopped_until = {"robot": 0, "joystick": 0}
        self.lost_until = self.blind_until = self.asserted_until = self.late_until = 0
        self.late_ms = {}
        self.given_ms = self.young_ms = 0
        self.resume_at = self.release_at = -1
        #: With force, and without.
        self.hz = (None, 50, None, 250)[seed % 4]
        self.start_joystick()
        self.start_robot()
        #: When the robot knows, since when a press counts, and what.
        self.interruptions = [(0, 0, "the start")]
        self.pressed, self.press_until = False, 0
        self.presses, self.press_came_ms, self.released_ms = deque(), 0, 0
        self.heard_ms = 0
        self.moved_ms = 0
        self.sequence = 0
        self.wrong = []

    def start_joystick(self):
        self.lives += 1
        self.handle = OperatedHandle(PageDevice(), paused=self.paused)
        link = joystick_link(boot_id=self.lives, command_hz=self.hz)
        self.space = JoystickSide(link=link, handle=self.handle, felt=self.hz is None)

    def start_robot(self):
        self.lives += 1
        self.envelope = SafetyEnvelope(LIMITS, now_ns=self.now_ms * MS)
        link = robot_link(boot_id=self.lives, command_hz=self.hz)
        self.ground = RobotSide(link=link, envelope=self.envelope, felt=self.hz is None)
        self.born_ms = self.now_ms

    def slack_ms(self):
        """How much later than usual the robot may hear of what happens at the hand."""
        return OLD_MS if self.now_ms < self.late_until + LATEST_MS + SETTLES_MS else 0

    def note(self, what, *, at_hand=False):
        knows_ms = self.now_ms + (self.slack_ms() if at_hand else 0)
        self.interruptions.append((knows_ms, self.now_ms, what))

    def interrupt(self):
        """Do one thing to the session."""
        random, now_ms = self.random, self.now_ms
        lasts_ms = random.choice((100, 250, 350, 450, 600, 3000))
        what = random.choice(self.deeds)
        if what == "lost":
            self.lost_until = now_ms + lasts_ms
        elif what.startswith("stop"):
            self.stopped_until[what.split()[1]] = now_ms + lasts_ms
        elif what == "kill robot":
            self.note(what)
            self.start_robot()
        elif what == "kill joystick":
            self.note(what, at_hand=True)
            self.start_joystick()
        elif what == "halt":
            self.handle.handle_command(JoystickEvent.HALT)
            self.paused = "halt"
            self.resume_at = now_ms + lasts_ms
            self.note(what, at_hand=True)
        elif what == "emergency":
            self.asserted_until = now_ms + lasts_ms
            self.release_at = now_ms + 2 * lasts_ms
        elif what == "late":
            ways = random.choice((("down",), ("down",), ("up",), ("down", "up")))
            self.late_ms = {way: random.choice((600, 1500, 4000, 10_000)) for way in ways}
            self.late_until = now_ms + 4 * lasts_ms
        elif what == "blind":
            self.blind_until = now_ms + lasts_ms
        else:
            self.note(what)
            self.envelope.require_press(Hold.OWNER if what == "owner" else Hold.CAMERA)

    def person(self):
        """Move the hand, and let go or press when it is time."""
        now_ms = self.now_ms
        if now_ms >= self.press_until:
            self.pressed = not self.pressed
            if self.pressed:
                # The device hears of it with the hand's next input.
                self.presses.append(now_ms + -now_ms % 4)
            else:
                self.released_ms = now_ms
            held = self.random.uniform(800, 3000), self.random.uniform(50, 500)
            self.press_until = now_ms + round(held[0] if self.pressed else held[1])
        if now_ms % 4 == 0:
            self.sequence += 1
            turn = 2 * pi * 0.5 * now_ms / 1000
            hand = PageInput(self.pressed, 0.5 * sin(turn), 0.5 * cos(turn), 0, self.sequence)
            age_ns = 0
            self.handle.device.handle_input(hand._replace(received_ns=now_ms * MS), age_ns)

    def step(self):
        """One millisecond."""
        now_ms, now_ns = self.now_ms, self.now_ms * MS
        self.person()
        if now_ms >= self.stopped_until["joystick"]:
            if 0 <= self.resume_at <= now_ms:
                self.resume_at, self.paused = -1, ""
            # The person starts it again, whatever halted it.
            if (
                now_ms % 100 == 0
                and not self.paused
                and self.handle.handle_command(JoystickEvent.START) == ""
            ):
                self.note("a start", at_hand=True)
            self.handle.stop = now_ms < self.asserted_until
            self.handle.blind = now_ms < self.blind_until
            while self.up and self.up[0][0] <= now_ms:
                self.space.handle_datagram(self.up.popleft()[1], now_ns)
            self.space.handle_cycle(now_ns, MS)
            self.send(self.space, "down")
        if now_ms >= self.stopped_until["robot"]:
            if 0 <= self.release_at <= now_ms:
                self.release_at = -1
                if self.envelope.handle_stop_released(now_ns) == "":
                    self.note("the emergency stop's end")
            heard = self.ground.link.counts.received
            while self.down and self.down[0][0] <= now_ms:
                _, datagram, self.given_ms = self.down.popleft()
                self.ground.handle_datagram(datagram, now_ns)
                while self.presses and self.presses[0] <= self.given_ms:
                    self.presses.popleft()
                    self.press_came_ms = now_ms
            if self.ground.link.counts.received != heard:
                if now_ms - self.heard_ms > self.gap_ms:
                    self.note("commands were missing")
                self.heard_ms = now_ms
            self.ground.handle_cycle(now_ns, MS)
            self.send(self.ground, "up")
        self.judge()
        self.now_ms += 1

    def send(self, side, name):
        way, now_ms = getattr(self, name), self.now_ms
        late_ms = self.late_ms.get(name, 0) if now_ms < self.late_until else 0
        due_ms = max(now_ms + self.delay_ms + late_ms, way[-1][0] if way else 0)
        sample = side.poll_transmit(now_ms * MS)
        # What a late path holds is in no socket.
        room = len(way) < SOCKET_DEPTH or due_ms > now_ms + self.delay_ms
        if sample is not None and now_ms >= self.lost_until and room:
            way.append((due_ms, sample, now_ms))

    def judge(self):
        """The robot may move only by a press that came after the newest interruption."""
        now_ms, robot = self.now_ms, self.ground.robot
        # A robot that is stopped cannot come to rest.
        if now_ms - self.given_ms <= OLD_MS or now_ms < self.stopped_until["robot"]:
            self.young_ms = now_ms
        if now_ms - self.born_ms < SETTLES_MS or now_ms < self.stopped_until["robot"]:
            return
        if hypot(robot.vx_m_s, robot.vy_m_s) < MOVES_M_S:
            return
        self.moved_ms += 1
        settled_ms = now_ms - SETTLES_MS
        if self.young_ms < settled_ms:
            self.wrong.append(f"{now_ms}: moves by commands of {self.given_ms}")
        _, since_ms, what = max(each for each in self.interruptions if each[0] <= settled_ms)
        if self.press_came_ms <= since_ms:
            self.wrong.append(f"{now_ms}: moves after {what} at {since_ms}, without a new press")
        elif not self.pressed and self.released_ms < settled_ms - self.delay_ms - self.slack_ms():
            self.wrong.append(f"{now_ms}: moves without the button")

    def run(self, cycles):
        due_ms = 4500
        while self.now_ms < cycles:
            if self.now_ms == due_ms:
                self.interrupt()
                due_ms += self.random.randrange(200, 5000)
            self.step()
        return self.wrong


def random_network(random):
    """Draw a network: most are bad in one way, some in all."""
    all_ways = random.random() < 0.1

    def draw(*choices):
        return random.choice(choices) if all_ways or random.random() < 0.15 else 0

    return Network(
        delay_ms=random.choice((2, 10, 40, 100, 300)),
        jitter_ms=draw(5, 30, 200),
        loss=draw(0.01, 0.1, 0.5, 1.0),
        burst_ms=draw(3, 20, 300),
        rate_kbps=draw(40, 300, 600),
        reordered=draw(0.01, 0.2),
        reorder_ms=draw(3, 15, 60),
        repeated=draw(0.01, 0.2),
    )


class NetworkWay:
    """One direction of a network that changes; what overtakes is put back in order."""

    def __init__(self):
        self.paths, self.order = [], FrameOrder()
        self.sent, self.came = [], set()

    def send(self, sample, now_ms):
        self.sent.append((sample, now_ms))
        self.paths[-1].handle_datagram(len(self.sent).to_bytes(60, "big"), now_ms * MS)

    def arrive(self, now_ms):
        now_ns = now_ms * MS
        for path in self.paths:
            while (datagram := path.poll_transmit(now_ns)) is not None:
                number = int.from_bytes(datagram, "big")
                # The protected channel drops what comes again.
                if number not in self.came:
                    self.came.add(number)
                    self.order.handle_record(0, number, (datagram,), now_ns)
        while (datagram := self.order.poll_frame(now_ns)) is not None:
            sample, sent_ms = self.sent[int.from_bytes(datagram, "big") - 1]
            yield now_ms, sample, sent_ms


class NetworkEnds(Ends):
    """The same over a network whose delay, losses, rate and order change at random."""

    #: Gaps are of any length here, and the newest command counts until it is too old.
    gap_ms = GAP_MS + round(LIMITS.command_max_age_s * 1000)

    def __init__(self, seed):
        super().__init__(seed)
        self.deeds = DEEDS
        self.ways = {"down": NetworkWay(), "up": NetworkWay()}
        self.changes_ms = 0

    def slack_ms(self):
        return OLD_MS

    def step(self):
        if self.now_ms >= self.changes_ms:
            self.changes_ms += self.random.choice((200, 1000, 4000))
            for way in self.ways.values():
                way.paths.append(NetworkPath(random_network(self.random), self.random.random()))
        for name, way in self.ways.items():
            getattr(self, name).extend(way.arrive(self.now_ms))
        super().step()

    def send(self, side, name):
        sample = side.poll_transmit(self.now_ms * MS)
        if sample is not None and self.now_ms >= self.lost_until:
            self.ways[name].send(sample, self.now_ms)
