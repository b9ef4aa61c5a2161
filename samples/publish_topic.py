"""Publish a topic in shared memory, and read it in another process.

    python samples/publish_topic.py            both ends, for two seconds
    python samples/publish_topic.py publish    one end, until Ctrl-C ...
    python samples/publish_topic.py read       ... and the other, in another terminal

A picture is drawn into shared memory and read from there without a copy. Start several
readers, kill the publisher and start it again: the readers then see pictures again.
"""

import multiprocessing
import os
import sys
from contextlib import suppress

import numpy as np

from kontur_av import CaptureStamp, MonotonicClock, TopicBus
from kontur_av.clock import NS_PER_MS, NS_PER_S

WIDTH, HEIGHT, FPS = 640, 480, 30
OCTETS = WIDTH * HEIGHT * 3 // 2


def publish(session: str, seconds: float) -> None:
    clock = MonotonicClock()
    with TopicBus(session) as bus:
        writer = bus.writer("camera/mine", max_octets=OCTETS)
        begin_ns = clock.now_ns()
        for sequence in range(round(seconds * FPS)):
            clock.sleep_until_ns(begin_ns + sequence * NS_PER_S // FPS)
            # 1. Borrow a buffer in shared memory.  2. Fill it.  3. Hand it over, with its stamp.
            loan = writer.loan_picture(WIDTH, HEIGHT)
            now_ns = clock.now_ns()
            loan.picture[:HEIGHT] = sequence % 220 + 16
            loan.picture[HEIGHT:] = 128
            loan.publish(CaptureStamp(now_ns, sequence, "mine"))


def read(session: str, seconds: float) -> None:
    clock = MonotonicClock()
    ages_us = []
    with TopicBus(session) as bus:
        # The newest picture is wanted, so one is kept; `depth=8` and `next()` give each in turn.
        reader = bus.reader("camera/mine")
        end_ns = clock.now_ns() + round(seconds * NS_PER_S)
        while clock.now_ns() < end_ns:
            if not reader.wait(100 * NS_PER_MS):
                continue
            lease = reader.latest()
            if lease is None:
                continue
            with lease:
                frame = lease.video()
                brightness = frame.data[: frame.height].mean()
                ages_us.append((clock.now_ns() - frame.stamp.capture_ns) / 1000)
                if frame.stamp.sequence % FPS == 0:
                    print(f"picture {frame.stamp.sequence}: brightness {brightness:.0f}")
    if ages_us:
        middle = np.median(ages_us)
        print(f"{len(ages_us)} pictures of {OCTETS} octets, {middle:.0f} us old in the middle")


def main() -> None:
    for_ever = 1e6
    if sys.argv[1:] == ["publish"]:
        publish("my-topics", for_ever)
    elif sys.argv[1:] == ["read"]:
        read("my-topics", for_ever)
    else:
        session = f"sample-{os.getpid()}"
        # Fork first: a process that has a bus may not fork any more.
        reader = multiprocessing.Process(target=read, args=(session, 2.0))
        reader.start()
        publish(session, 2.0)
        reader.join()


if __name__ == "__main__":
    with suppress(KeyboardInterrupt):
        main()
