"""A plug-in of pytest: tests that need the machine run one at a time, once more if they fail.

One worker runs them, one after the other. The others run the rest beside them, at the lowest
priority, so that it takes only what the first leaves of the machine.

Such a test that fails runs again at once, with new fixtures. If it passes then, it is *unsteady*:
the last lines name it, and the first failure's output is printed and kept in a file. A test that
fails twice fails. pytest-rerunfailures would do it again, too, but hides why it failed first, and
does not order the tests.
"""

import contextlib
import os
from pathlib import Path

import pytest
from _pytest.runner import runtestprotocol
from xdist.remote import Producer
from xdist.scheduler import LoadScopeScheduling

#: Tests in these rooms start processes that need the machine.
SERIAL = ("tests/browser/", "tests/realtime/")
#: Those in this one start processes, too, but mostly wait: one at a time, beside the serial ones.
BESIDE = "tests/interop/"

UNSTEADY = "unsteady"


def lane_of(nodeid: str) -> int:
    """0: serial; 1: one at a time, beside those; 2: wherever and whenever."""
    if nodeid.startswith(SERIAL):
        return 0
    return 1 if nodeid.startswith(BESIDE) else 2


class Lanes(LoadScopeScheduling):
    """The serial tests to the first worker, those beside them to the second, any test to any."""

    def _split_scope(self, nodeid: str) -> str:
        lane = lane_of(nodeid)
        if lane < 2:
            return f"lane {lane}"
        # Simulations of one file share their runs.
        return nodeid.partition("::")[0] if nodeid.startswith("tests/sim/") else nodeid


def yield_the_machine() -> None:
    """Take from now on only what other processes leave of the processors.

    Linux weighs sessions of processes against each other first (autogroup), then the processes of
    one session.
    """
    if os.getpriority(os.PRIO_PROCESS, 0) == 19:
        return
    group = Path("/proc/self/autogroup")
    if group.exists():
        try:
            group.write_text("19")
        except OSError:
            # Only root may do so more than ten times a second; the next test tries again.
            return
    os.nice(19)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--unsteady",
        metavar="FILE",
        help="keep the output of unsteady tests here (otherwise in pytest's cache)",
    )


def pytest_xdist_make_scheduler(config: pytest.Config, log: Producer) -> Lanes:
    return Lanes(config, log)


def pytest_configure(config: pytest.Config) -> None:
    if hasattr(config, "workerinput"):
        # Linux keeps a priority for each process session.
        with contextlib.suppress(OSError):
            os.setsid()


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    items.sort(key=lambda item: lane_of(item.nodeid))


def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
    if lane_of(item.nodeid) == 2:
        if hasattr(item.config, "workerinput"):
            yield_the_machine()
        return None
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    reports = runtestprotocol(item, log=False, nextitem=nextitem)
    failed = [report for report in reports if report.failed]
    if failed:
        # The second run makes the fixtures of the module and of the session anew.
        with contextlib.suppress(Exception):
            item.session._setupstate.teardown_exact(None)
        item._report_sections.clear()
        reports = runtestprotocol(item, log=False, nextitem=nextitem)
        if any(report.failed for report in reports):
            for report in reports:
                if report.failed:
                    report.sections.append(("First run", "\n".join(map(_output, failed))))
        else:
            for report in failed:
                report.outcome = UNSTEADY  # type: ignore[assignment]
            reports = [*failed, *reports]
    for report in reports:
        item.ihook.pytest_runtest_logreport(report=report)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True


def pytest_report_teststatus(report: pytest.TestReport) -> tuple[str, str, str] | None:
    return (UNSTEADY, "U", "UNSTEADY") if report.outcome == UNSTEADY else None


def pytest_terminal_summary(
    terminalreporter: pytest.TerminalReporter, config: pytest.Config
) -> None:
    reports = terminalreporter.stats.get(UNSTEADY, [])
    if not reports:
        return
    terminalreporter.section("unsteady: failed, and passed when they ran once more")
    for report in reports:
        terminalreporter.write_sep("_", report.nodeid)
        terminalreporter.write_line(_output(report))
    path = _file(config)
    if path is not None:
        path.write_text("".join(f"{report.nodeid}\n{_output(report)}\n\n" for report in reports))
        terminalreporter.write_line(f"The same is in {path}.")
    for report in reports:
        terminalreporter.write_line(f"UNSTEADY {report.nodeid}")


def _output(report: pytest.TestReport) -> str:
    printed = [f"--- {name} ---\n{text}" for name, text in report.sections]
    return "\n".join([report.longreprtext, *printed])


def _file(config: pytest.Config) -> Path | None:
    chosen = config.getoption("unsteady")
    if chosen:
        return Path(chosen)
    cache = getattr(config, "cache", None)
    return cache.mkdir("unsteady") / "unsteady.txt" if cache is not None else None
