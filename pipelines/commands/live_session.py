"""What the live commands have in common: the table in the terminal, and the report at the end."""

import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import msgspec

from kontur_av.errors import ConfigError, refused
from pipelines.report.collector import Collector
from pipelines.report.event_log import EventLog
from pipelines.report.model import ReplayReport
from pipelines.report.report_file import end_report
from pipelines.report.session_feed import end_trace, session_report
from pipelines.report.upkeep_now import UPKEEP, ExperimentWatch
from pipelines.session.kept_files import KeptOrders, NotesReader, SessionNow, write_now
from pipelines.session.launcher import Launcher
from pipelines.session.options import StreamOptions
from pipelines.session.setup.segments import Segment
from pipelines.upkeep.requests import status_teller
from telepresence.upkeep.version_stack import status_of


def made_directory(path: Path, option: str, *, make: bool = True) -> Path:
    """The directory of an option, which is made if need be; ConfigError if it cannot be.

    make: False to find out only whether it could be.
    """
    whole = path.absolute()
    with refused(f"{option} {path}"):
        if make:
            whole.mkdir(parents=True, exist_ok=True)
        there = next(folder for folder in (whole, *whole.parents) if folder.exists())
    if not (there.is_dir() and os.access(there, os.W_OK | os.X_OK)):
        raise ConfigError(f"{option} {path}: cannot be written to; choose another directory")
    return whole


def end_session(
    args: StreamOptions,
    collector: Collector,
    launcher: Launcher,
    *,
    replay: ReplayReport | None = None,
) -> int:
    """Write and print the report of a session that has ended; 1 if it names a failure."""
    collector.handle_end()
    report = session_report(launcher, collector)
    if collector.trace is not None:
        report = msgspec.structs.replace(report, trace=end_trace(collector, launcher))
    if replay is not None:
        report = msgspec.structs.replace(report, replay=replay)
    return end_report(report, args.report, quiet=args.quiet)


def with_status(
    show: Callable[[Launcher], None],
    collector: Collector,
    end: Segment,
    log: EventLog | None = None,
) -> Callable[[Launcher], None]:
    """Return a `show` that also tells a keeper of versions how the session is.

    With a `log` it tells `kontur-av maintain`, too, and takes its notes into the log. Without a log
    the user's programs are attached, and their haptic samples tell whether an experiment runs.
    """
    publish = status_teller()
    attached = ExperimentWatch(collector, attached=True)
    notes: NotesReader | None = None
    forgotten = ""

    def show_and_publish(launcher: Launcher) -> None:
        nonlocal notes, forgotten
        now_ns = launcher.clock.now_ns()
        if log is None:
            experiment = attached.handle_time(now_ns)
        else:
            experiment = log.upkeep.experiment
            notes = notes or NotesReader(launcher.session)
            for note in notes.read():
                log.handle_note(note.what, note.text, now_ns)
            if (problem := KeptOrders(launcher.session).settle()) != forgotten:
                forgotten = problem
                log.handle_note("session", problem or "an emergency stop is kept again", now_ns)
            events = [event for event in log.events if event.what == UPKEEP]
            with suppress(OSError):
                write_now(launcher.session, SessionNow(experiment=experiment, events=events))
        link = collector.gateway(end).link
        if publish is not None and link is not None:
            publish(replace(status_of(link.supervision), busy=bool(experiment)))
        show(launcher)

    return show_and_publish
