"""A page's hand, joystick, channel and robot on virtual time, interrupted at random.

The person moves all the time, and lets go of the dead-man button at random, not when something
happens. The judge knows when an interruption began and when the button went down, nothing of the
safety envelope.
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
#: Datagrams that a socket holds for an end that is stopped.
SOCKET_DEPTH = 277


class Ends:
    """One session. `run` returns what the robot did that nobody ordered, in words."""

    def __init__(self, seed):
        self.random = Random(seed)
        self.now_ms = 0
        self.delay_ms = self.random.choice((5, 20, 60, 150))
        self.down, self.up = deque(), deque()
        self.lives = 1
        self.paused = ""
        self.stopped_until = {"robot": 0, "joystick": 0}
        self.lost_until = self.blind_until = self.asserted_until = 0
        self.resume_at = self.release_at = -1
        self.start_joystick()
        self.start_robot()
        self.interruptions = [(0, "the start")]
        self.pressed, self.press_until = False, 0
        self.presses, self.released_ms = [], 0
        self.heard_ms = 0
        self.moved_ms = 0
        self.sequence = 0
        self.wrong = []

    def start_joystick(self):
        self.lives += 1
        self.handle = OperatedHandle(PageDevice(), paused=self.paused)
        self.space = JoystickSide(link=joystick_link(life=self.lives), handle=self.handle)

    def start_robot(self):
        self.lives += 1
        self.envelope = SafetyEnvelope(LIMITS, now_ns=self.now_ms * MS)
        self.ground = RobotSide(link=robot_link(life=self.lives), envelope=self.envelope)
        self.born_ms = self.now_ms

    def note(self, what):
        self.interruptions.append((self.now_ms, what))

    def interrupt(self):
        """Do one thing to the session."""
        random, now_ms = self.random, self.now_ms
        lasts_ms = random.choice((100, 250, 350, 450, 600, 3000))
        what = random.choice(DEEDS)
        if what == "lost":
            self.lost_until = now_ms + lasts_ms
        elif what.startswith("stop"):
            self.stopped_until[what.split()[1]] = now_ms + lasts_ms
        elif what == "kill robot":
            self.note(what)
            self.start_robot()
        elif what == "kill joystick":
            self.note(what)
            self.start_joystick()
        elif what == "halt":
            self.handle.handle_command(JoystickEvent.HALT)
            self.paused = "halt"
            self.resume_at = now_ms + lasts_ms
            self.note(what)
        elif what == "emergency":
            self.asserted_until = now_ms + lasts_ms
            self.release_at = now_ms + 2 * lasts_ms
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
                self.presses.append(now_ms)
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
                self.note("a start")
            self.handle.stop = now_ms < self.asserted_until
            self.handle.blind = now_ms < self.blind_until
            while self.up and self.up[0][0] <= now_ms:
                self.space.handle_datagram(self.up.popleft()[1], now_ns)
            self.space.handle_cycle(now_ns, MS)
            self.send(self.space, self.down)
        if now_ms >= self.stopped_until["robot"]:
            if 0 <= self.release_at <= now_ms:
                self.release_at = -1
                if self.envelope.handle_stop_released(now_ns) == "":
                    self.note("the emergency stop's end")
            heard = self.ground.link.received
            while self.down and self.down[0][0] <= now_ms:
                self.ground.handle_datagram(self.down.popleft()[1], now_ns)
            if self.ground.link.received != heard:
                if now_ms - self.heard_ms > GAP_MS:
                    self.note("commands were missing")
                self.heard_ms = now_ms
            self.ground.handle_cycle(now_ns, MS)
            self.send(self.ground, self.up)
        self.judge()
        self.now_ms += 1

    def send(self, side, way):
        sample = side.poll_transmit(self.now_ms * MS)
        if sample is not None and self.now_ms >= self.lost_until and len(way) < SOCKET_DEPTH:
            way.append((self.now_ms + self.delay_ms, sample))

    def judge(self):
        """The robot may move only by a press that came after the newest interruption."""
        now_ms, robot = self.now_ms, self.ground.robot
        if now_ms - self.born_ms < SETTLES_MS or now_ms < self.stopped_until["robot"]:
            return
        if hypot(robot.vx_m_s, robot.vy_m_s) < MOVES_M_S:
            return
        self.moved_ms += 1
        settled_ms = now_ms - SETTLES_MS
        since_ms, what = max(each for each in self.interruptions if each[0] <= settled_ms)
        if not self.presses or self.presses[-1] <= since_ms - self.delay_ms:
            self.wrong.append(f"{now_ms}: moves after {what} at {since_ms}, without a new press")
        elif not self.pressed and self.released_ms < settled_ms - self.delay_ms:
            self.wrong.append(f"{now_ms}: moves without the button")

    def run(self, cycles):
        due_ms = 4500
        while self.now_ms < cycles:
            if self.now_ms == due_ms:
                self.interrupt()
                due_ms += self.random.randrange(200, 5000)
            self.step()
        return self.wrong
