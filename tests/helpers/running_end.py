"""One end of a session that is split between two machines, as a user runs it."""

import re

from running_session import RunningSession, eventually, written

from pipelines.session.setup.segments import Segment
from pipelines.session.setup.setup_file import load_setup
from pipelines.table import topology_of

_SHOWN = re.compile(r"(\w+) (\d+) (?:shown|received)")


class RunningEnd(RunningSession):
    """`kontur-av stream --end`. prefix: the words before the command, which choose its host."""

    def __init__(self, setup, end, *options, directory, prefix=()):
        directory.mkdir(exist_ok=True)
        setup = written(setup, directory)
        self.setup = load_setup(setup)
        topology = topology_of(self.setup, recorder=True, segments=(Segment(end),))
        self.prefix = prefix
        words = ["stream", "--setup", setup, "--end", end, "--no-page", *map(str, options)]
        self._begin(topology.processes_here, words, directory)

    def shown(self):
        lines = self.lines()
        return {name: int(count) for name, count in _SHOWN.findall(lines[-1])} if lines else {}

    def wait_for_flow(self, names=None):
        """Wait until every stream that comes out here shows more, in a line after the next one."""
        lines = len(self.lines())
        eventually(lambda: len(self.lines()) > lines, "a line of figures")
        super().wait_for_flow(names)
