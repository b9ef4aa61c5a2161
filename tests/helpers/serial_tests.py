"""A plug-in of pytest: tests that need the machine run last, one at a time, once more if they fail.

Such a test that fails runs again at once, with new fixtures. If it passes then, it is *unsteady*:
the last lines name it, and the first failure's output is printed and kept in a file. A test that
fails twice fails. pytest-rerunfailures would do it again, too, but hides why it failed first, and
does not order the tests.
"""

import contextlib
from pathlib import Path

import pytest
from _pytest.runner import runtestprotocol
from xdist.remote import Producer
from xdist.scheduler import LoadScopeScheduling
from xdist.workermanage import WorkerController

#: Tests in these rooms start processes that need the machine.
SERIAL = ("tests/browser/", "tests/realtime/")
#: Those in this one start processes, too, but mostly wait: one at a time, beside quick tests.
BESIDE = "tests/interop/"

UNSTEADY = "unsteady"


def is_serial(nodeid: str) -> bool:
    return nodeid.startswith(SERIAL)


def runs_again(nodeid: str) -> bool:
    return nodeid.startswith((*SERIAL, BESIDE))


class SerialLast(LoadScopeScheduling):
    """Any test to any worker; then the serial ones to one worker, when all others have ended.

    A worker of pytest-xdist 3.8 runs a test only when it knows the next one, or that there is none.
    """

    def _split_scope(self, nodeid: str) -> str:
        if is_serial(nodeid):
            return "serial"
        if nodeid.startswith(BESIDE):
            return BESIDE
        # Simulations of one file share their runs.
        return nodeid.partition("::")[0] if nodeid.startswith("tests/sim/") else nodeid

    def _assign_work_unit(self, node: WorkerController) -> None:
        # What a crashed worker leaves is appended.
        if "serial" in self.workqueue:
            self.workqueue.move_to_end("serial")
        if "serial" not in self.workqueue or len(self.workqueue) > 1 or self._is_last(node):
            super()._assign_work_unit(node)

    def _reschedule(self, node: WorkerController) -> None:
        if list(self.workqueue) != ["serial"]:
            super()._reschedule(node)
        elif node.shutting_down:
            return
        elif any(not other.shutting_down for other in self.nodes if other is not node):
            node.shutdown()
        else:
            self._assign_work_unit(node)

    def _is_last(self, node: WorkerController) -> bool:
        others = [self.assigned_work[other] for other in self.nodes if other is not node]
        return not any(self._pending_of(work) for work in others)

    def mark_test_complete(
        self, node: WorkerController, item_index: int, duration: float = 0
    ) -> None:
        super().mark_test_complete(node, item_index, duration)
        for other in self.nodes:
            if other is not node and list(self.workqueue) == ["serial"]:
                self._reschedule(other)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--unsteady",
        metavar="FILE",
        help="keep the output of unsteady tests here (otherwise in pytest's cache)",
    )


def pytest_xdist_make_scheduler(config: pytest.Config, log: Producer) -> SerialLast:
    return SerialLast(config, log)


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    items.sort(key=lambda item: is_serial(item.nodeid))


def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
    if not runs_again(item.nodeid):
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
