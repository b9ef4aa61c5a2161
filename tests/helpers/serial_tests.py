"""A plug-in of pytest: tests that start processes run one at a time, once more if they fail.

With pytest-xdist each lane of `LANES` is one worker's, and quick tests beside them give way: they
take what the live sessions leave of the processors. Without it those of lanes run last.

Such a test that fails runs again at once, with new fixtures. If it passes then, it is *unsteady*:
the last lines name it, and the first failure's output is printed and kept in a file. A test that
fails twice fails. pytest-rerunfailures would do it again, too, but hides why it failed first, and
does not order the tests.
"""

import contextlib
import os
from functools import cache
from pathlib import Path

import pytest
from _pytest.runner import runtestprotocol
from xdist import is_xdist_worker
from xdist.remote import Producer
from xdist.scheduler import LoadScopeScheduling
from xdist.workermanage import WorkerController

#: Beginnings of modules that start no whole session.
PARTS = (
    *("tests/browser/test_page_layout.", "tests/browser/test_study_page."),
    *(
        f"tests/realtime/test_{name}"
        for name in (
            *("bench_", "command_output.", "doctor_here.", "fresh_process.", "launcher_"),
            *("link_command.", "media_parts.", "microphone.", "page_topics.", "process_ends."),
            *("rtc_peers.", "sessions.", "sources_live.", "stream_ends.", "topics", "upkeep."),
            "whip_client.",
        )
    ),
)
#: And of some with a small session, which mostly waits.
SMALL = tuple(
    f"tests/realtime/test_{name}."
    for name in (
        *("joystick_session", "maintain", "own_telemetry", "packets_udp", "remote_update"),
        "yamcs",
    )
)
#: Of each lane one test runs at a time. Two large sessions take more than two processors.
LANES = (
    ("tests/interop/", "tests/samples/", *PARTS, *SMALL),
    ("tests/browser/", "tests/realtime/"),
)
_AUTOGROUP = Path("/proc/self/autogroup")

UNSTEADY = "unsteady"


def lane_of(nodeid: str) -> int:
    """Of a test; the number of lanes for a quick one."""
    return next((lane for lane, rooms in enumerate(LANES) if nodeid.startswith(rooms)), len(LANES))


def is_quick(nodeid: str) -> bool:
    return lane_of(nodeid) == len(LANES)


class LanesFirst(LoadScopeScheduling):
    """Each lane to one worker; then any file to any worker."""

    def _split_scope(self, nodeid: str) -> str:
        # Tests of one file share what they simulate.
        return nodeid.partition("::")[0] if is_quick(nodeid) else f"lane {lane_of(nodeid)}"

    def _assign_work_unit(self, node: WorkerController) -> None:
        # What a crashed worker leaves is appended.
        for scope in [scope for scope in self.workqueue if scope.startswith("lane ")]:
            self.workqueue.move_to_end(scope, last=False)
        super()._assign_work_unit(node)


@cache
def give_way() -> None:
    """From now on take only what other processes leave of the processors."""
    with contextlib.suppress(OSError):
        # Linux shares the time among sessions of the kernel first, so this one needs its own.
        os.setsid()
        _AUTOGROUP.write_text("19")
    os.nice(19)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--unsteady",
        metavar="FILE",
        help="keep the output of unsteady tests here (otherwise in pytest's cache)",
    )


def pytest_xdist_make_scheduler(config: pytest.Config, log: Producer) -> LanesFirst:
    return LanesFirst(config, log)


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(session: pytest.Session, items: list[pytest.Item]) -> None:
    if is_xdist_worker(session):
        items.sort(key=lambda item: lane_of(item.nodeid))
    else:
        items.sort(key=lambda item: not is_quick(item.nodeid))


def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
    if is_quick(item.nodeid):
        if is_xdist_worker(item.session):
            give_way()
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
