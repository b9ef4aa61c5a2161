"""A page process without the rest of a session, and the publisher of its numbered pictures."""

import os
import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from benchmarks.page.footage import FPS, HEIGHT, WIDTH
from kontur_av.clock import NS_PER_S, MonotonicClock
from kontur_av.media import CaptureStamp
from kontur_av.streams.coded_unit import MOST_UNIT_OCTETS, CodedUnit
from kontur_av.topics.bus import TopicBus
from pipelines.seats.process_page import run_page
from pipelines.session.page_sockets import PageHost, PageListener, bind_pages, listeners
from pipelines.session.process import Context
from pipelines.session.sessions import hold_session
from pipelines.session.setup.segments import Segment
from pipelines.session.setup.setup_file import load_setup
from pipelines.session.topology.table import Topology
from pipelines.session.topology.topics import PAGES
from pipelines.table import topology_of

#: The seat's main picture: the stream of 640x480 that ground control receives.
STREAM = "downlink_video"
_FIRST_PORT = 8290
#: For a process to end by itself.
_TIMEOUT_S = 5.0


@dataclass(frozen=True, kw_only=True)
class PageAlone:
    """A running page process. session: whose topics it reads. pid: of the process."""

    session: str
    topology: Topology
    listener: PageListener
    pid: int


@contextmanager
def page_alone(segment: Segment) -> Iterator[PageAlone]:
    """Serve the seat of `segment` from a process of its own, of a session without any other."""
    topology = topology_of(load_setup("spacejustin"), joystick="page", pages=True)
    sockets = bind_pages(PageHost(), _FIRST_PORT, [segment.value])
    (listener,) = listeners(sockets, PageHost(), None).values()
    with hold_session("bench-page") as session:
        context = Context(
            session=session,
            topology=topology,
            clock=MonotonicClock(),
            pages={PAGES[segment]: listener},
        )
        with forked(_serve, context, segment) as pid:
            yield PageAlone(session=session, topology=topology, listener=listener, pid=pid)
        listener.socket.close()


@contextmanager
def forked(run: Callable[..., None], *arguments: Any) -> Iterator[int]:
    """Call `run` in a forked process, yield its process id, and end it afterwards."""
    child = get_context("fork").Process(target=run, args=arguments, daemon=True)
    child.start()
    assert child.pid is not None
    try:
        yield child.pid
    finally:
        child.terminate()
        child.join(_TIMEOUT_S)
        child.kill()
        child.join()


def cpu_s(pid: int) -> float:
    """Return the CPU seconds of a running process."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def publish(
    session: str,
    topic: str,
    units: Sequence[tuple[bytes, bool]],
    published: Any,
) -> None:
    """Publish coded pictures at their rate; write each one's instant in ns into `published`."""
    clock = MonotonicClock()
    with suppress(KeyboardInterrupt), TopicBus(session) as bus:
        writer = bus.writer(topic, max_octets=MOST_UNIT_OCTETS)
        begin_ns = clock.now_ns()
        for number, (data, key) in enumerate(units):
            clock.sleep_until_ns(begin_ns + number * NS_PER_S // FPS)
            unit = CodedUnit(data=data, key=key, width=WIDTH, height=HEIGHT).pack()
            now_ns = clock.now_ns()
            published[number] = now_ns
            writer.publish_octets(unit, CaptureStamp(now_ns, number, "bench", rtp_timestamp=number))
        signal.pause()


def _serve(context: Context, segment: Segment) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: setattr(context, "stopping", True))
    run_page(context, segment=segment)
