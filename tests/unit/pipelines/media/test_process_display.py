"""The processes of display and snapshots."""

from contextlib import contextmanager

from kontur_av.clock import NS_PER_S, MonotonicClock
from pipelines.media.process_display import run_snapshots
from pipelines.session.process import TIMEOUT_NS, Context
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.table import topology_of


class Ending(Context):
    """A session that ends while a snapshot waits for a picture: no topic has a writer any more."""

    waited_ns = 0

    @contextmanager
    def open_bus(self):
        yield self

    def reader(self, topic):
        return self

    def wait(self, timeout_ns):
        self.stopping = True
        self.waited_ns += timeout_ns
        return False

    def latest(self):
        return None

    def close(self):
        pass


def test_snapshots_that_are_due_at_the_end_do_not_hold_it_up(tmp_path):
    clock = MonotonicClock()
    started_ns = clock.now_ns() - NS_PER_S + 1_000_000
    topology = topology_of(BUILT_IN["spacejustin"])
    context = Ending("s", topology, clock, snapshots=tmp_path, started_ns=started_ns)
    run_snapshots(context)
    assert 0 < context.waited_ns <= TIMEOUT_NS
