"""The results of checks: as a table in a terminal, and as rows of a report."""

from collections.abc import Sequence

from rich.console import Console
from rich.table import Table
from rich.text import Text

from kontur_av.clock import NS_PER_S
from pipelines.report.model import CheckReport, FigureReport, JoystickTestReport, TransitionReport
from pipelines.session.setup.setup_file import load_setup
from telepresence.haptics.device.checks import CheckBench
from telepresence.haptics.device.script import CheckResult
from telepresence.haptics.specs import is_simulated

SETUP_ROW = "--setup NAME  the setup whose axes it has"


def axes_of(setup: str | None) -> Sequence[str] | None:
    """Return the axes behind x and y of this setup; None without one. ConfigError."""
    return None if setup is None else load_setup(setup).more_axes


def print_results(console: Console, results: Sequence[CheckResult]) -> int:
    """Print each figure with its limits. Return the exit code: 1 if a check failed."""
    console.print(_table(results))
    for result in results:
        if words := result.trouble or result.skipped:
            console.print(f"{result.name}: {words}", highlight=False, soft_wrap=True)
    return 1 if any(result.failed for result in results) else 0


def _table(results: Sequence[CheckResult]) -> Table:
    table = Table()
    for name in ("check", "figure"):
        table.add_column(name)
    for name in ("measured", "least", "most"):
        table.add_column(name, justify="right")
    table.add_column("")
    for result in results:
        if result.skipped:
            table.add_row(result.name, "", "", "", "", "skipped")
        elif not result.metrics:
            table.add_row(result.name, "", "", "", "", _verdict(result.passed))
        for index, figure in enumerate(result.metrics):
            unit = f" {figure.unit}" if figure.unit else ""
            table.add_row(
                result.name if index == 0 else "",
                figure.name,
                "—" if figure.value is None else f"{figure.value:.4g}{unit}",
                _limit(figure.least),
                _limit(figure.most),
                _verdict(figure.passed),
            )
    return table


def _limit(value: float | None) -> str:
    return "" if value is None else f"{value:.4g}"


def _verdict(passed: bool) -> Text:
    return Text("passed", "green") if passed else Text("FAILED", "bold red")


def joystick_report(
    spec: str, bench: CheckBench, seconds: float, *, passed: bool
) -> JoystickTestReport:
    virtual = is_simulated(spec)
    return JoystickTestReport(
        device=spec,
        virtual_time=virtual,
        seconds=round(seconds, 3),
        passed=passed,
        checks=[_check_report(result) for result in bench.results],
        joystick=bench.operation.report(),
        transitions=[
            TransitionReport(
                s=round(transition.now_ns / NS_PER_S, 3) if virtual else None,
                before=transition.before.words,
                event=transition.event.value,
                after=transition.after.words,
                reason=transition.reason,
            )
            for transition in iter(bench.operation.next_event, None)
        ],
    )


def _check_report(result: CheckResult) -> CheckReport:
    return CheckReport(
        name=result.name,
        passed=None if result.skipped else result.passed,
        trouble=result.trouble,
        skipped=result.skipped,
        metrics=[
            FigureReport(
                name=figure.name,
                value=_rounded(figure.value),
                unit=figure.unit,
                least=_rounded(figure.least),
                most=_rounded(figure.most),
                passed=figure.passed,
            )
            for figure in result.metrics
        ],
    )


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 6)
