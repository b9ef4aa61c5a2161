"""A plug-in of pytest: which tests run by default, and which run beside which. One table says both.

`pytest` runs the default tier, `pytest --full` everything. A test that fails has failed; none is
tried again. In the full tier a test that lacks a program fails; in the default tier the last lines
name each missing program once.
"""

import contextlib
import enum
import fcntl
import os
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest


class Lane(enum.IntEnum):
    """Tests of one lane run one at a time, in one worker; the lanes run beside each other."""

    MACHINE = 0  #: Real processes that need the machine.
    WAITS = 1  #: Real processes that mostly wait, and programs of others.
    ANY = 2  #: No processes: in any worker at any time, at the lowest priority.


@dataclass(frozen=True)
class Row:
    """What holds for the tests whose node ids begin with `where`; the longest such row counts."""

    where: str
    lane: Lane = Lane.ANY
    default: bool = False
    alone: bool = False  #: No test of another lane with processes runs beside it.


def _rows(
    lane: Lane, default: bool, room: str, places: str = "", *, alone: bool = False
) -> Iterator[Row]:
    for place in places.split() or [""]:
        yield Row(f"tests/{room}{place}", lane, default, alone)


#: The journeys: "realtime/" and "test_x.py::test_y" make "tests/realtime/test_x.py::test_y".
_JOURNEYS = {
    "realtime/": """
        test_session.py::test_every_stream_flows_through_one_link
        test_session_kills.py::test_each_process_is_killed_once
        test_session_kills.py::test_processes_end_with_a_killed_launcher
        test_recording.py::test_the_file_has_what_the_report_says
        test_files.py::test_files_go_both_ways_across_a_loss_of_signal
        test_safety.py::test_a_halt_outlives_the_joystick_and_a_stop_outlives_both
        test_link_command.py::test_programs_talk_through_it_and_strangers_do_not
        test_link_command.py::test_two_ends_that_trust_each_other_carry_datagrams
        """,
    "browser/": """
        test_seats.py::test_both_seats_show_the_session
        test_seats.py::test_a_pointer_moves_the_robot_and_its_release_stops_it
        test_page_faults.py::test_a_page_comes_back_when_its_server_was_killed
        test_page_layout.py::test_no_page_scrolls_sideways_cuts_a_text_or_shuts_people_out
        """,
    "interop/": """
        test_send_receive.py::test_gstreamer_shows_the_h264_that_we_send
        test_send_receive.py::test_we_play_what_gstreamer_sends[h264-none]
        """,
}
#: Modules of tests/realtime that mostly wait. None has a whole session, or this lane would go on
#: for minutes after the other one.
_WAITING = """
    test_bench_all_run test_bench_children test_bench_console test_command_output
    test_fresh_process test_launcher test_loudspeaker test_readme_commands test_recipes
    test_rtc_peers test_upkeep test_whip_client
"""

#: Long courses on virtual time.
_LONG = """
    test_deadband_video test_haptics_grid test_haptics_mediated test_mission_tasks
    test_simulate_files test_sweep_command
    """
#: What needs packages that only the extra `full` has.
_PACKAGES = """
    sim/test_cluster sim/test_mujoco_robot sim/test_so101_robot
    unit/pipelines/recording/export/test_lerobot
    """

TABLE = (
    *_rows(Lane.ANY, True, "", "unit/ vectors/ fuzz/ sim/ web/ project/ samples/"),
    *_rows(Lane.MACHINE, True, "samples/", "test_sample_join_session"),
    *_rows(Lane.MACHINE, False, "", "realtime/"),
    # A page takes more than a core.
    *_rows(Lane.MACHINE, False, "browser/", alone=True),
    *_rows(Lane.MACHINE, False, "realtime/", "test_bench_page test_bench_live", alone=True),
    # These processes run at the idle priority, so another lane would starve them.
    *_rows(Lane.MACHINE, False, "realtime/", "test_foxglove test_ros2", alone=True),
    *_rows(Lane.WAITS, False, "interop/"),
    *_rows(Lane.WAITS, False, "realtime/", _WAITING),
    *_rows(Lane.ANY, False, "sim/", _LONG),
    *_rows(Lane.ANY, False, "", _PACKAGES),
    *(row for room, names in _JOURNEYS.items() for row in _rows(Lane.MACHINE, True, room, names)),
)

#: Who asks for one of these needs files that only the full tier has: real footage, real speech.
FULL_FIXTURES = {"footage", "pictures", "speech"}

#: A skip for one of these reasons is no missing program: the machine itself cannot do it.
MACHINE_REASONS = ("this machine", "no block of free UDP ports")

_LOWEST_PRIORITY = 19
_LEFT_OUT = pytest.StashKey[int]()


def row_of(nodeid: str) -> Row:
    """Return the row of the table that holds for a test."""
    rows = [row for row in TABLE if nodeid.startswith(row.where)]
    return max(rows, key=lambda row: len(row.where), default=Row(nodeid, default=True))


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("tiers")
    group.addoption("--full", action="store_true", help="run all tests, not the default tier alone")
    group.addoption(
        "--skip-default", action="store_true", help="with --full: only what the default leaves out"
    )


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "full: not in the default tier; tests/helpers/tiers.py")
    if hasattr(config, "workerinput"):
        # Linux keeps a priority for each process session.
        with contextlib.suppress(OSError):
            os.setsid()


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """As many workers as lanes; none for tests that are named one by one."""
    if any(".py" in argument for argument in config.args):
        return 0
    return len(Lane) if config.option.full else 2


def pytest_xdist_make_scheduler(config, log):
    from xdist.scheduler import LoadScopeScheduling

    class Lanes(LoadScopeScheduling):
        """A lane to one worker, any other test to any."""

        def _split_scope(self, nodeid: str) -> str:
            lane = row_of(nodeid).lane
            if lane is not Lane.ANY:
                return lane.name
            # Simulations of one file share their runs.
            return nodeid.partition("::")[0] if nodeid.startswith("tests/sim/") else nodeid

    return Lanes(config, log)


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """With `--skip-default`: a file that has no test of the full tier is not even imported."""
    if not (config.option.full and config.option.skip_default) or collection_path.suffix != ".py":
        return None
    where = collection_path.relative_to(config.rootpath).as_posix() + "::"
    if not row_of(where).default or any(row.where.startswith(where) for row in TABLE):
        return None
    text = collection_path.read_text(encoding="utf-8")
    return None if any(name in text for name in FULL_FIXTURES) else True


def _place(item: pytest.Item) -> tuple[Lane, bool]:
    """What runs alone comes last in its lane, when the other lanes are through.

    Before it, a test of another lane would run, alone too, in each gap between two of them.
    """
    row = row_of(item.nodeid)
    return row.lane, row.alone


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    items.sort(key=_place)
    for item in items:
        fixtures = FULL_FIXTURES.intersection(getattr(item, "fixturenames", ()))
        if fixtures or not row_of(item.nodeid).default:
            item.add_marker("full")
    left_out = [item for item in items if _is_left_out(config, item)]
    if left_out:
        config.hook.pytest_deselected(items=left_out)
        items[:] = [item for item in items if item not in set(left_out)]
    config.stash[_LEFT_OUT] = len(left_out)
    if hasattr(config, "workeroutput"):
        config.workeroutput["left_out"] = len(left_out)


def _is_left_out(config: pytest.Config, item: pytest.Item) -> bool:
    full = item.get_closest_marker("full") is not None
    if config.option.full:
        return config.option.skip_default and not full
    # A file or test that the command line names runs in any tier.
    return full and not any(
        Path(argument.partition("::")[0]).name == item.path.name for argument in config.args
    )


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    row = row_of(item.nodeid)
    with contextlib.ExitStack() as held:
        if hasattr(item.config, "workerinput"):
            if row.lane is Lane.ANY:
                _yield_the_machine()
            else:
                held.enter_context(_room_for(row))
        return (yield)


@contextlib.contextmanager
def _room_for(row: Row) -> Iterator[None]:
    """Keep the machine for a test: whole, or shared with those of other lanes."""
    admission, room = (os.open(path, os.O_RDONLY) for path in (__file__, Path(__file__).parent))
    try:
        # Who waits for the whole machine stands in the door, so that no other goes in.
        fcntl.flock(admission, fcntl.LOCK_EX)
        fcntl.flock(room, fcntl.LOCK_EX if row.alone else fcntl.LOCK_SH)
        fcntl.flock(admission, fcntl.LOCK_UN)
        yield
    finally:
        for lock in (admission, room):
            # A child of the test may have a copy, so closing is not enough.
            fcntl.flock(lock, fcntl.LOCK_UN)
            os.close(lock)


def _yield_the_machine() -> None:
    """Take from now on only what other processes leave of the processors.

    Linux weighs sessions of processes against each other first (autogroup), then the processes of
    one session.
    """
    if os.getpriority(os.PRIO_PROCESS, 0) == _LOWEST_PRIORITY:
        return
    group = Path("/proc/self/autogroup")
    if group.exists():
        try:
            group.write_text(str(_LOWEST_PRIORITY))
        except OSError:
            # Only root may do so more than ten times a second; the next test tries again.
            return
    os.nice(_LOWEST_PRIORITY)


def _reason(report: pytest.TestReport | pytest.CollectReport) -> str:
    text = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
    return text.removeprefix("Skipped: ")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Iterator[None]:
    return _full_or_failed(item.config, (yield))


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(collector: pytest.Collector) -> Iterator[None]:
    return _full_or_failed(collector.config, (yield))


def _full_or_failed(config, report):
    """In the full tier, what lacks a program or package fails."""
    if config.option.full and report.skipped and not hasattr(report, "wasxfail"):
        reason = _reason(report)
        if not reason.startswith(MACHINE_REASONS):
            report.outcome = "failed"
            report.longrepr = f"the full tier skips nothing: {reason}"
    return report


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    skipped = terminalreporter.stats.get("skipped", [])
    missing = Counter(_reason(one) for one in skipped if row_of(one.nodeid).default)
    if missing:
        terminalreporter.section("not run, because something is missing here")
        for reason, count in sorted(missing.items()):
            terminalreporter.write_line(f"{count} {'test' if count == 1 else 'tests'}: {reason}")


def pytest_testnodedown(node, error) -> None:
    """Every worker collects all tests, so any one knows how many were left out."""
    if "left_out" in getattr(node, "workeroutput", {}):
        node.config.stash[_LEFT_OUT] = node.workeroutput["left_out"]


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_sessionfinish(session: pytest.Session) -> Iterator[None]:
    yield
    config = session.config
    left_out = config.stash.get(_LEFT_OUT, 0)
    reporter = config.pluginmanager.get_plugin("terminalreporter")
    if left_out and not config.option.full and not hasattr(config, "workerinput"):
        counts = {word: len(reporter.stats.get(word, ())) for word in ("failed", "error", "passed")}
        told = ", ".join(f"{n} {word}" for word, n in counts.items() if n or word == "passed")
        reporter.write_line(f"{told}; {left_out} live tests not run: pytest --full")
