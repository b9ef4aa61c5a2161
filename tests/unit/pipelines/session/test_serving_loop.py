"""A serving process ticks until it shall stop, and ends for its own mistakes only."""

import asyncio

import pytest

from kontur_av.clock import MonotonicClock
from pipelines.session.process import Context
from pipelines.session.serving_loop import ServingLoop
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.table import topology_of

PATIENCE_S = 20


def run(begin, ticks=3):
    """Run until that many ticks were handled; `begin` is given the loop. Return the ticks."""

    async def serve():
        context = Context("test", topology_of(BUILT_IN["taskboard"]), MonotonicClock())
        instants = []

        def handle(now_ns):
            instants.append(now_ns)
            context.stopping = len(instants) >= ticks

        serving = ServingLoop(context, handle)
        begin(serving)
        async with asyncio.timeout(PATIENCE_S):
            await serving.run()
        return instants

    return asyncio.run(serve())


async def fail(error):
    raise error


def test_it_ticks_until_the_process_shall_stop():
    instants = run(lambda serving: None)
    assert instants == sorted(instants)
    assert len(instants) == 3


def test_a_task_that_does_not_end_is_cancelled_in_the_end():
    ended = []

    async def wait():
        try:
            await asyncio.Event().wait()
        finally:
            ended.append(True)

    run(lambda serving: serving.begin(wait()))
    assert ended == [True]


def test_a_mistake_of_a_task_or_of_a_callback_ends_it():
    with pytest.raises(ValueError, match="a task"):
        run(lambda serving: serving.begin(fail(ValueError("a task"))), ticks=100)

    def call():
        raise ValueError("a callback")

    with pytest.raises(ValueError, match="a callback"):
        run(lambda serving: serving.loop.call_soon(call), ticks=100)


def test_no_fault_of_a_peer_or_its_network_ends_it():
    def call():
        raise ConnectionResetError

    assert len(run(lambda serving: serving.loop.call_soon(call))) == 3
