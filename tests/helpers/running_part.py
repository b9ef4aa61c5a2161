"""A process of a session as a thread of the test: real sockets and topics."""

import socket
import threading
from contextlib import contextmanager, suppress
from dataclasses import replace

from common import eventually

from kontur_av.clock import MonotonicClock
from pipelines.session.probe import Message
from pipelines.session.process import Context
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.table import topology_of

SETUP = replace(BUILT_IN["spacejustin"], base_port=29_300)
CLOCK = MonotonicClock()


@contextmanager
def running(session, part, *, setup=SETUP, pages=False, **arguments):
    """Run a part in a thread; yields a function that returns all its figures so far."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    topology = topology_of(setup, pages=pages)
    context = Context(session=session, topology=topology, clock=CLOCK, link=theirs)
    ours.setblocking(False)
    reported = Message()

    def listen():
        # After the other end has closed nothing more comes.
        with suppress(BlockingIOError):
            while data := ours.recv(1 << 20):
                message = Message.unpack(data)
                reported.metrics.update(message.metrics)
                reported.series += message.series
        return reported

    thread = threading.Thread(target=part, args=(context,), kwargs=arguments)
    thread.start()
    try:
        # The first report comes when its sockets and topics are open.
        eventually(lambda: listen().metrics)
        yield listen
    finally:
        context.stopping = True
        thread.join(10)
        context.flush(CLOCK.now_ns())
        listen()
        theirs.close()
