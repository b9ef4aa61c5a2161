"""One run of `benchmarks all`: a bench in a process of its own, and what is kept of it."""

import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec

from benchmarks.all.plan import Measurement
from benchmarks.all.records import Record, Report
from benchmarks.machine import this_machine
from pipelines.session.command_process import end_all, ended_alike


def words_of(command: str) -> list[str]:
    """The words for Python of a command as a reader types it."""
    program, *words = command.split()
    return ["-m", "pipelines.cli", *words] if program == "kontur-av" else words


def measure(measurement: Measurement, number: int, code: str) -> Record:
    """Run the bench once. A bench that wrote no report has a record without headlines."""
    began = datetime.now(UTC)
    with ended_alike(), TemporaryDirectory() as name:
        report_file, output = Path(name) / "report.json", Path(name) / "output"
        command = [sys.executable, *words_of(measurement.command)]
        with output.open("wb") as log:
            process = subprocess.Popen(
                [*command, "--report", str(report_file)],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                # A session of its own: this process takes Ctrl-C and ends the other.
                start_new_session=True,
            )
            try:
                exit_code = process.wait()
            finally:
                end_all([process])
        words = output.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        last = words[-1].strip() if words else f"ended with {exit_code}"
        try:
            headlines = msgspec.json.decode(report_file.read_bytes(), type=Report).headlines
        except (OSError, msgspec.MsgspecError):
            headlines, exit_code = (), exit_code or 1
    return Record(
        name=measurement.name,
        title=measurement.title,
        command=measurement.command,
        number=number,
        date=began.isoformat(timespec="seconds"),
        code=code,
        machine=this_machine(),
        failure=last if exit_code else "",
        headlines=headlines,
    )
