"""The process of one session: `python -m pipelines.virtual.campaign.session REPORT`.

It reads a pickled `SessionTask` from its standard input, which only the process that started it
writes. The session ends when that input is closed, so that no session outlives its starter.
"""

import pickle
import select
import sys
from pathlib import Path

from kontur_av.errors import ConfigError
from pipelines.report.report_file import write_report
from pipelines.virtual.campaign.tasks import SessionTask
from pipelines.virtual.inputs import check_virtual_sources
from pipelines.virtual.simulate import simulate

#: The exit codes of a session that ran, and of one that its setup forbids.
RAN, REFUSED = 0, 2


def main() -> int:
    """Run the session; the report of one that was ended early shows fewer seconds."""
    task = pickle.load(sys.stdin.buffer)
    assert isinstance(task, SessionTask)
    try:
        check_virtual_sources(task.setup)
        report = simulate(
            task.setup,
            seconds=task.seconds,
            seed=task.seed,
            media=task.media,
            plan=task.plan,
            stopped=_left_alone,
        )
    except ConfigError as error:
        print(error, file=sys.stderr)
        return REFUSED
    write_report(Path(sys.argv[1]), report)
    return RAN


def _left_alone() -> bool:
    """Whether standard input is closed: nothing more is ever written to it."""
    return bool(select.select([sys.stdin], [], [], 0)[0])


if __name__ == "__main__":
    sys.exit(main())
