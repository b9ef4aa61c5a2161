"""What pictures to many readers cost, by iceoryx2 and by files: `python tests/fan_out.py`."""

import argparse
import multiprocessing
import os
import resource
import time
from multiprocessing.connection import Connection
from statistics import median

import numpy as np

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.media import CaptureStamp
from kontur_av.topics.bus import MAX_READERS, TopicBus
from kontur_av.topics.session_files import remove_session

_WIDTH, _HEIGHT, _FPS = 640, 480, 30
_KINDS = ("iceoryx2", "files")


def main() -> None:
    """Measure both kinds in turn, and print medians and spread."""
    parser = argparse.ArgumentParser(description=__doc__, allow_abbrev=False)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=5.0)
    args = parser.parse_args()
    found: dict[tuple[str, int], list[tuple[float, float, float]]] = {}
    for _ in range(args.runs):
        for readers in (1, MAX_READERS):
            for kind in _KINDS:
                figures = found.setdefault((kind, readers), [])
                figures.append(_measured(kind, readers, args.seconds))
    print("640x480 at 30 a second: publication to a view of it, p50 and p99; CPU of all processes")
    for (kind, readers), runs in found.items():
        p50, p99, cpu = (
            f"{median(one):.1f} ({min(one):.1f} to {max(one):.1f})"
            for one in zip(*runs, strict=True)
        )
        print(f"{kind:<9} {readers:2} readers: {p50} µs, {p99} µs, {cpu} % of a core")


def _measured(kind: str, readers: int, seconds: float) -> tuple[float, float, float]:
    os.environ["KONTUR_AV_TOPICS"] = "" if kind == "iceoryx2" else "files"
    session = f"bench-{os.getpid()}-{time.monotonic_ns() % 100_000}"
    spawn = multiprocessing.get_context("spawn")
    ends = [spawn.Pipe(duplex=False) for _ in range(readers + 1)]
    works = [_read] * readers + [_write]
    processes = [
        spawn.Process(target=work, args=(session, seconds, tell))
        for work, (_, tell) in zip(works, ends, strict=True)
    ]
    for process in processes:
        process.start()
    told = [listen.recv() for listen, _ in ends]
    for process in processes:
        process.join()
    remove_session(session)
    ages = np.concatenate([ages for ages, _ in told[:-1]])
    p50, p99 = np.percentile(ages, (50, 99)) / 1000
    return float(p50), float(p99), 100 * sum(cpu_s for _, cpu_s in told) / seconds


def _cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def _write(session: str, seconds: float, tell: Connection) -> None:
    with TopicBus(session) as bus:
        writer = bus.writer("pictures", max_octets=_WIDTH * _HEIGHT * 3 // 2)
        time.sleep(3)  # until all readers are there
        before_s, begin_ns = _cpu_s(), time.monotonic_ns()
        for number in range(round(seconds * _FPS)):
            due_ns = begin_ns + number * NS_PER_S // _FPS
            time.sleep(max(0, due_ns - time.monotonic_ns()) / NS_PER_S)
            loan = writer.loan_picture(_WIDTH, _HEIGHT)
            loan.picture[:] = number % 200
            loan.publish(CaptureStamp(due_ns, number, "bench"))
        tell.send(([], _cpu_s() - before_s))


def _read(session: str, seconds: float, tell: Connection) -> None:
    ages: list[int] = []
    with TopicBus(session) as bus:
        reader = bus.reader("pictures")
        before_s = _cpu_s()
        patience_ns = 10 * NS_PER_S
        while reader.wait(patience_ns):
            lease = reader.latest()
            if lease is None:
                continue
            with lease:
                seen = int(lease.video().data[0, 0])
                if seen == lease.stamp.sequence % 200:
                    ages.append(time.monotonic_ns() - lease.published_ns)
            # Interpreter and imports are not counted.
            before_s = before_s if len(ages) > 1 else _cpu_s()
            patience_ns = 500 * NS_PER_MS
    tell.send((ages, _cpu_s() - before_s))


if __name__ == "__main__":
    main()
