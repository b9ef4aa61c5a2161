"""A serving process ticks until it shall stop, and ends for its own mistakes only."""

import asyncio

import pytest

from kontur_av.clock import MonotonicClock
from pipelines.session.process import Context
from pipelines.session.serving_loop import ServingLoop
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.table import topology_of


def run(begin=lambda serving: None, ticks=3):
    """Run until that many ticks were handled; `begin` is given the loop. Return the ticks."""

    async def serve():
        context = Context("test", topology_of(BUILT_IN["taskboard"]), MonotonicClock())
        instants = []

        def handle(now_ns):
            instants.append(now_ns)
            context.stopping = len(instants) >= ticks

        serving = ServingLoop(context, handle)
        begin(serving)
        async with asyncio.timeout(20):
            await serving.run()
        return instants

    return asyncio.run(serve())


def failing(error):
    def fail():
        raise error

    async def fail_later():
        raise error

    return {
        "task": lambda serving: serving.begin(fail_later()),
        "callback": lambda serving: serving.loop.call_soon(fail),
    }


def test_it_ticks_until_the_process_shall_stop_whatever_faults_its_peers_have():
    ended = []

    async def wait():
        try:
            await asyncio.Event().wait()
        finally:
            ended.append(True)

    instants = run(lambda serving: serving.begin(wait()))
    assert len(instants) == 3 and instants == sorted(instants)
    assert ended == [True]
    assert len(run(failing(ConnectionResetError())["callback"])) == 3


@pytest.mark.rule("7")
@pytest.mark.parametrize("where", ["task", "callback"])
def test_a_mistake_of_its_own_ends_it(where):
    with pytest.raises(ValueError, match="a bug"):
        run(failing(ValueError("a bug"))[where], ticks=100)
