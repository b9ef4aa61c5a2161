"""Two newcomers, who do only what the sentences of their seats say, come to steer: real cores."""

import json
import re

from common import first_seed, repeats
from random_ends import MS, Ends

from pipelines.hand.hand_topics import RobotOrders
from pipelines.hand.robot_commands import JoystickStatusTeller, RobotCommands
from pipelines.mission.tmtc_messages import command_from_words
from pipelines.seats.plan import seat_plan
from pipelines.seats.seat import Seat
from pipelines.session.access import Role
from pipelines.session.mission_messages import RobotCommand
from pipelines.session.setup.segments import Segment
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.session.situation import Terminal, at_terminal
from pipelines.table import topology_of
from telepresence.haptics.device.states import JoystickEvent
from telepresence.haptics.envelope import Hold
from telepresence.tasks.definitions import ControlMode
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary

DICTIONARY = built_in_dictionary()
TOPOLOGY = topology_of(BUILT_IN["spacejustin"], pages=True, joystick="page")
LOOK_MS, REACTS_MS, RELEASED_MS = 100, 300, 400
DEEDS = ("power", "fault", "mode", "halt", "stop")


class SeatPage:
    def __init__(self, segment):
        plan = seat_plan(TOPOLOGY, segment, "session", DICTIONARY)
        self.seat = Seat(plan, first_command=1)
        self.page = self.seat.handle_opened(Role.OPERATOR, 0)

    def says(self, now_ns, link):
        self.seat.handle_signal(link, now_ns)
        self.seat.handle_time(now_ns)
        told = None
        while (message := self.seat.poll_transmit(self.page)) is not None:
            if isinstance(message, str) and (text := json.loads(message))["kind"] == "state":
                told = text["situation"]
        return told


class NewcomerEnds(Ends):
    """Interrupted at random, also by hand; from `follow` on two people do what they read."""

    def __init__(self, seed):
        self.service, self.orders = None, RobotOrders(powered=True, mode="telepresence")
        super().__init__(seed)
        #: At a terminal one reads and types, and a person at the handle only presses.
        self.terminal = seed % 2 == 1
        self.follows = False
        self.seats = {segment: SeatPage(segment) for segment in Segment}
        self.read = []
        self.press_at = self.steered_at = -1
        self.acted_ms, self.typed_ms = dict.fromkeys(Segment, 0), 0

    def start_joystick(self):
        super().start_joystick()
        self.teller = JoystickStatusTeller(self.handle)
        self.teller.handle_watched(True)

    def start_robot(self):
        super().start_robot()
        if self.service is not None:
            self.orders = self.service.orders
        self.service = RobotCommands(
            self.ground,
            boot_id=self.lives,
            tasks=False,
            now_ns=self.now_ms * MS,
            orders=self.orders,
        )

    def interrupt(self):
        deed = self.random.choice((*DEEDS, *[""] * 5))
        control = self.service.control
        if deed == "power":
            control.set_power(False)
        elif deed == "fault":
            control.handle_fault("a wire is loose")
        elif deed == "mode":
            control.set_power(False)
            control.set_mode(self.random.choice(("position", "telepresence")))
            control.set_power(self.random.random() < 0.5)
        elif deed:
            self.handle.handle_command(JoystickEvent(deed))
            self.paused = deed
        else:
            super().interrupt()

    def follow(self):
        """Nothing else happens from now on, but what lasts still does."""
        self.follows, self.paused = True, "until a newcomer resumes it"
        self.resume_at = self.release_at = -1
        self.late_until = 0
        self.pressed = self.random.random() < 0.5

    def person(self):
        if self.follows:
            self.press_until = 1 << 40
            if self.now_ms == self.press_at:
                self.pressed = True
        super().person()

    def step(self):
        now_ms, now_ns = self.now_ms, self.now_ms * MS
        if now_ms >= self.stopped_until["robot"]:
            self.service.step(now_ns)
        super().step()
        if now_ms >= self.stopped_until["joystick"]:
            self.handle.handle_feedback(self.space.link.latest(now_ns))
        if now_ms % LOOK_MS == 0:
            self.look(now_ms, now_ns)

    def look(self, now_ms, now_ns):
        space, ground = self.seats[Segment.SPACE], self.seats[Segment.GROUND]
        runs = now_ms >= self.stopped_until["joystick"]
        if runs and (status := self.teller.poll_status(now_ns)) is not None:
            space.seat.handle_status(status, now_ns)
        if now_ms >= self.stopped_until["robot"]:
            ground.seat.handle_shown("robot", self.service.status(now_ns), now_ns)
        link = now_ms >= self.lost_until
        for segment, seat in self.seats.items():
            told = seat.says(now_ns, link)
            self.check(segment, told, link)
            presses = told["next"] in ("press", "let go, then press", "steer")
            if self.follows and (presses or not self.terminal):
                self.do(segment, told, now_ms)
        ends = [each.seat._known(each.page, now_ns) for each in self.seats.values()]
        told = at_terminal(ends, Terminal())
        if self.follows and self.terminal and now_ms - self.typed_ms >= REACTS_MS:
            self.typed_ms = now_ms
            self.read.append((now_ms, "terminal", told.why, told.next, told.words))
            self.type(told.advice, now_ns)

    def type(self, advice, now_ns):
        """Give the command lines of an advice."""
        for line in re.findall("`kontur-av (.*?)`", advice):
            if line == "stop --release":
                self.asserted_until = self.now_ms
                self.envelope.handle_stop_released(now_ns)
                continue
            _, name, *words = line.split()
            sent = command_from_words(DICTIONARY.application(name), words, client="", number=0)
            if name == "joystick":
                assert self.handle.handle_command(JoystickEvent(sent.name)) == "", line
                continue
            command = RobotCommand(1, sent.name, *map(ControlMode, sent.arguments))
            self.service.handle_command(command, now_ns, now_ns)
            assert self.service.status(now_ns).command_refusal == "", line

    def check(self, segment, told, link):
        if told["why"] == "follows":
            assert link and told["advice"] == ""
            if segment is Segment.GROUND and self.now_ms >= self.stopped_until["robot"]:
                assert self.envelope.hold is Hold.NONE
        if told["next"] in ("press", "let go, then press"):
            assert segment is Segment.SPACE and link
            assert not self.handle.blind and self.handle.drive == "hand"

    def do(self, segment, told, now_ms):
        if told["why"] == "follows" and segment is Segment.SPACE:
            self.steered_at = now_ms
        if now_ms - self.acted_ms[segment] < REACTS_MS or now_ms < self.press_at:
            return
        self.read.append((now_ms, segment.value, told["why"], told["next"], told["reason"]))
        self.acted_ms[segment] = now_ms
        control, wanted = self.service.control, told["next"]
        if wanted == "press":
            self.pressed = True
        elif wanted == "let go, then press":
            self.pressed, self.press_at = False, now_ms + RELEASED_MS
        elif wanted == "joystick request":
            button = told["advice"].split("“")[1].split("”")[0].lower()
            assert self.handle.handle_command(JoystickEvent(button)) == "", told
        elif wanted == "release the stop":
            self.asserted_until = now_ms
            self.envelope.handle_stop_released(now_ms * MS)
        elif wanted == "reset the robot":
            assert control.reset() == ""
        elif wanted == "power on":
            assert control.set_power(True) == "", told
        elif wanted == "power off, set mode":
            control.set_power(False)
            assert control.set_mode("telepresence") == "" and control.set_power(True) == ""


def test_whoever_does_only_what_the_seats_say_comes_to_steer():
    seen = set()
    for seed in range(first_seed(0), first_seed(0) + repeats(10)):
        ends = NewcomerEnds(seed)
        ends.run(ends.random.randrange(5_000, 12_000))
        ends.follow()
        until_ms = ends.now_ms + 30_000
        while ends.steered_at < 0 and ends.now_ms < until_ms:
            ends.step()
        assert ends.steered_at > 0, (seed, ends.read[-4:])
        assert ends.envelope.hold is Hold.NONE, (seed, ends.read[-4:])
        seen |= {(why, to_do) for _, _, why, to_do, _ in ends.read}
    assert len(seen) > 8, seen
