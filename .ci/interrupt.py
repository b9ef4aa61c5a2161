"""Interrupt a live session at random while a hand that never lets go by itself moves its robot.

    python .ci/interrupt.py --minutes 10 --seed 1

Not part of CI. Processes are killed, or stopped for three seconds; the joystick is halted, the
robot switched off, an emergency stop ordered, another camera selected. The hand moves all the time.
It lets go of the dead-man button at random, not when something happens.

The judge knows when an interruption began and when the button went down, nothing of the safety
envelope: the robot may move only if the button went down after the newest interruption began, and
is still down. Exit code 1 if it moved otherwise, or if it never followed.
"""

import argparse
import os
import random
import signal
import sys
import tempfile
import threading
import time
from bisect import bisect_right
from dataclasses import dataclass, field
from functools import partial
from itertools import count
from math import hypot, pi, sin
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "helpers")]

from running_session import RunningSession, eventually  # noqa: E402

from kontur_av.clock import NS_PER_MS, NS_PER_S, MonotonicClock  # noqa: E402
from kontur_av.topics.bus import TopicBus  # noqa: E402
from pipelines.hand.hand_topics import HAND_INPUT_TOPIC  # noqa: E402
from pipelines.hand.haptic_trace import NO_SAMPLE, ROBOT_TRACE_TOPIC, rows_of  # noqa: E402
from pipelines.session.topic_ends import TopicWriter  # noqa: E402
from telepresence.haptics.device.page import PageInput  # noqa: E402

PERIOD_NS = 4 * NS_PER_MS
#: A robot that was interrupted comes to rest in this time, and so does one that was let go.
SETTLES_NS = 500 * NS_PER_MS
#: It moves if its tip went so far in `WINDOW_NS`. It gives way to what it touches.
MOVES_M, WINDOW_NS = 0.004, 200 * NS_PER_MS
#: Commands that are missing for longer are an interruption; `resume_within_s` with some margin.
GAP_NS = 350 * NS_PER_MS
STOPPED_S = 3.0
#: Only the oldest picture, and how long it may be shown, hold the robot: later than this.
BLIND_NS = 2_600 * NS_PER_MS
#: What each interrupts at once if it is stopped, or killed.
HAPTIC = ("robot", "joystick")
LINK = ("ground_gateway", "space_gateway")
CAMERAS = ("stereo", "static")
#: An order that holds the robot, and those that end it.
ORDERS = {
    "halt": ("tc joystick halt", "tc joystick start"),
    "power off": ("tc robot power_off", "tc robot power_on"),
    "emergency stop": ("stop", "stop --release", "tc robot power_on"),
}


@dataclass
class Log:
    """What happened; instants in ns."""

    #: (since, what): motion needs a press after it.
    interruptions: list[tuple[int, str]] = field(default_factory=list)
    #: (from, to): the robot's process was not there.
    absences: list[tuple[int, int]] = field(default_factory=list)
    presses: list[int] = field(default_factory=list)
    releases: list[int] = field(default_factory=list)
    #: (instant, x, y) of the tip.
    places: list[tuple[int, float, float]] = field(default_factory=list)


class Hand(threading.Thread):
    """Moves the handle in circles, and reads what the robot does."""

    def __init__(self, bus: TopicBus, log: Log, seed: int) -> None:
        super().__init__(daemon=True)
        self.page, self.numbers = TopicWriter(bus, HAND_INPUT_TOPIC), count(1)
        self.log, self.random = log, random.Random(seed)
        self.blocks = bus.reader(ROBOT_TRACE_TOPIC, depth=32)
        self.running = True
        self.received_ns = 0

    def run(self) -> None:
        clock = MonotonicClock()
        due_ns = began_ns = clock.now_ns()
        pressed, until_ns = True, due_ns + 3 * NS_PER_S
        self.log.presses.append(due_ns)
        while self.running:
            due_ns = max(due_ns + PERIOD_NS, clock.now_ns() - NS_PER_S)
            clock.sleep_until_ns(due_ns)
            now_ns = clock.now_ns()
            if now_ns >= until_ns:
                pressed = not pressed
                (self.log.presses if pressed else self.log.releases).append(now_ns)
                seconds = self.random.uniform(4, 14) if pressed else self.random.uniform(0.3, 1)
                until_ns = now_ns + round(seconds * NS_PER_S)
            turn = 2 * pi * 0.4 * (now_ns - began_ns) / NS_PER_S
            x, y = 0.4 * sin(turn), 0.4 * sin(turn + 1.0)
            self.page.publish(PageInput(pressed, x, y, 0, next(self.numbers), now_ns), now_ns)
            self.read()

    def read(self) -> None:
        """Read where the tip was, and look for gaps in the commands."""
        while (lease := self.blocks.next()) is not None:
            with lease:
                rows = rows_of(lease.octets())
            for row in rows:
                now_ns = int(row["time_ns"])
                if row["received"] != NO_SAMPLE:
                    if self.received_ns and now_ns - self.received_ns > GAP_NS:
                        self.log.interruptions.append((now_ns, "commands were missing"))
                    self.received_ns = now_ns
            self.log.places.append((now_ns, float(row["x_m"]), float(row["y_m"])))


class Interrupter:
    """Does one thing after another to the session."""

    def __init__(self, session: RunningSession, log: Log, seed: int) -> None:
        self.session, self.log, self.random = session, log, random.Random(seed)
        self.pids = session.pids()
        self.clock = MonotonicClock()
        self.camera = CAMERAS[0]
        self.deeds = {
            "kill": self.kill,
            "stop": self.stop,
            **{what: partial(self.hold, what) for what in ORDERS},
            "camera": self.select,
        }

    def one(self) -> str:
        """Do something; return what."""
        what = self.random.choices([*self.deeds], weights=[6, 6, 1, 1, 1, 1])[0]
        return self.deeds[what]()

    def note(self, what: str) -> None:
        self.log.interruptions.append((self.clock.now_ns(), what))

    def victim(self) -> str:
        return self.random.choice([*HAPTIC, *HAPTIC, *LINK, *self.pids])

    def kill(self) -> str:
        name = self.victim()
        if name in HAPTIC:
            self.note(f"{name} was killed")
        before_ns = self.clock.now_ns()
        self.session.kill(self.pids, name)
        if name == "robot":
            self.log.absences.append((before_ns, self.clock.now_ns() + NS_PER_S))
        return f"killed {name}"

    def stop(self) -> str:
        name = self.victim()
        pid = self.pids[name]
        began_ns = self.clock.now_ns()
        os.kill(pid, signal.SIGSTOP)
        time.sleep(STOPPED_S)
        if name in (*HAPTIC, *LINK):
            self.note(f"{name} was stopped")
        if name in ("space_display", "ground_uplink_video_send"):
            self.log.interruptions.append((began_ns + BLIND_NS, f"{name} was stopped"))
        os.kill(pid, signal.SIGCONT)
        return f"stopped {name}"

    def ask(self, words: str) -> None:
        """Give a command until it is carried out; a session that is not ready may refuse it."""
        eventually(lambda: self.session.ask(*words.split()).returncode == 0, words)

    def hold(self, what: str) -> str:
        """Give an order that holds the robot, perhaps kill a process, and end the order."""
        order, *ends = ORDERS[what]
        self.ask(order)
        self.note(what)
        if self.random.random() < 0.5:
            print(f"{self.clock.now_ns() / NS_PER_S:.2f} {self.kill()}", flush=True)
        time.sleep(2)
        # A press while it is off counts: that is how a task begins.
        if what != "power off":
            self.note(f"{what} ends")
        for each in ends:
            self.ask(each)
        return what

    def select(self) -> str:
        self.camera = CAMERAS[1 - CAMERAS.index(self.camera)]
        self.ask(f"select {self.camera}")
        self.note("another camera")
        return f"selected {self.camera}"


def judge(log: Log) -> tuple[list[str], float]:
    """Return the motions that nobody ordered, in words, and for how long (s) it moved at all."""
    wrong: list[str] = []
    interruptions = sorted(log.interruptions)
    begins = [at for at, _ in interruptions]
    moved_ns = 0
    first = 0
    places = log.places
    for at, (now_ns, x_m, y_m) in enumerate(places):
        while places[first][0] < now_ns - WINDOW_NS:
            first += 1
        since_ns, x0_m, y0_m = places[first]
        if any(begin < now_ns and since_ns < end for begin, end in log.absences):
            # A robot that starts stands elsewhere.
            continue
        if hypot(x_m - x0_m, y_m - y0_m) < MOVES_M:
            continue
        if at:
            moved_ns += now_ns - places[at - 1][0]
        newest = bisect_right(begins, now_ns - SETTLES_NS)
        began_ns, what = interruptions[newest - 1] if newest else (0, "the start")
        pressed = [each for each in log.presses if began_ns < each < now_ns]
        if not pressed:
            wrong.append(f"{now_ns / NS_PER_S:.2f}: moves after {what}, without a new press")
        else:
            released = [each for each in log.releases if pressed[-1] < each < now_ns - SETTLES_NS]
            if released:
                wrong.append(f"{now_ns / NS_PER_S:.2f}: moves with the button released")
    return wrong, moved_ns / NS_PER_S


def main() -> int:
    """Run the session, interrupt it, judge; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, allow_abbrev=False)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--log", action="store_true", help="print all that happened")
    arguments = parser.parse_args()
    log = Log()
    done: list[str] = []
    with (
        tempfile.TemporaryDirectory() as directory,
        RunningSession(
            "taskboard", "--page", "8340", "--joystick", "page", directory=directory
        ) as session,
    ):
        interrupter = Interrupter(session, log, arguments.seed)
        os.environ["TMPDIR"] = str(session.temporary)
        with TopicBus(session.session) as bus:
            hand = Hand(bus, log, arguments.seed)
            hand.start()
            end_s = time.monotonic() + 60 * arguments.minutes
            pauses = random.Random(arguments.seed)
            while time.monotonic() < end_s:
                time.sleep(pauses.uniform(2, 9))
                done.append(interrupter.one())
                print(f"{interrupter.clock.now_ns() / NS_PER_S:.2f} {done[-1]}", flush=True)
            hand.running = False
            hand.join()
        code, report = session.interrupt()
    wrong, moved_s = judge(log)
    if arguments.log:
        events = [*log.interruptions, *((at, "press") for at in log.presses)]
        events += [(at, "release") for at in log.releases]
        events += [(at, f"at {x_m:.3f} {y_m:.3f}") for at, x_m, y_m in log.places[::10]]
        print(*(f"{at / NS_PER_S:.2f} {what}" for at, what in sorted(events)), sep="\n")
    print(f"{len(done)} interruptions, {len(log.presses)} presses, moved for {moved_s:.0f} s")
    print(f"exit code {code}, safety: {report['safety']}, failures: {report['failures']}")
    print(f"{len(wrong)} motions outside the rules", *wrong[:20], sep="\n")
    return 1 if wrong or not moved_s else 0


if __name__ == "__main__":
    sys.exit(main())
