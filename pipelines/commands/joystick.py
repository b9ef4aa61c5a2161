"""`kontur-av joystick`: list the joysticks here, check one, or drive a robot with one."""

import argparse
from collections.abc import Callable
from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

from kontur_av.clock import NS_PER_MS, NS_PER_S, MonotonicClock
from kontur_av.errors import ConfigError
from pipelines.commands import drive
from pipelines.commands.common import (
    output_that_may_fail,
    say_unprotected,
    stopped_by_signals,
)
from pipelines.report.model import (
    CheckReport,
    FigureReport,
    JoystickTestReport,
    TransitionReport,
)
from pipelines.report.report_file import check_writable, write_report
from telepresence.haptics.device.check import CheckResult
from telepresence.haptics.device.checks import CHECKS, CheckBench
from telepresence.haptics.device.device import JoystickDevice
from telepresence.haptics.device.gamepad import find_gamepads
from telepresence.haptics.device.simulated import FAULTS
from telepresence.haptics.device.spec import PAGE, is_simulated, open_device
from telepresence.haptics.device.states import Transition
from telepresence.haptics.schedule import PeriodicSchedule

_ALL = "all"
_CYCLE_NS = NS_PER_MS
#: The longest time for all checks.
_LONGEST_NS = 300 * NS_PER_S


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """`list`, `test` and `drive`, with their options."""
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    text = "list the joysticks here, as --device and `stream --joystick` name them"
    actions.add_parser("list", help=text, description=text)
    text = "calibrate a joystick and do its functional checks, each against its limits"
    test = actions.add_parser("test", help=text, description=text)
    test.add_argument("check", nargs="?", default=_ALL, choices=[*CHECKS, _ALL])
    test.add_argument(
        "--device",
        default="sim",
        metavar="SPEC",
        help="sim, sim:FAULT, evdev, evdev:/dev/input/eventN, udp:HOST:PORT[:KEYFILE] or your own: "
        "module:Class (default: sim)",
    )
    test.add_argument("--report", type=Path, metavar="FILE", help="write all figures as JSON")
    text = "drive the robot, or the arm, that a session's setup gives a partner"
    drive.add_arguments(actions.add_parser("drive", help=text, description=text))


def run(args: argparse.Namespace) -> int:
    """0 if all is well; 1 if a check failed."""
    if args.action == "list":
        return _list()
    if args.action == "drive":
        return drive.drive(args)
    return _test(args.device, args.check, args.report)


def _list(print: Callable[[str], None] = print) -> int:
    print(
        f"sim{'':<29} the simulated joystick: motors, {len(FAULTS)} faults to check the checks with"
    )
    for fault in FAULTS:
        print(f"sim:{fault:<28} the same with this fault")
    print(f"{PAGE:<32} the simulated one in the hand of a person at a page; in a session only")
    try:
        found = find_gamepads()
    except ConfigError as error:
        print(str(error))
    else:
        for one in found:
            print(f"evdev:{one.path:<26} {one.problem or one.name}")
        if not found:
            print("no game controller here; the first that is plugged in is called evdev")
    print(
        f"{'udp:HOST:PORT[:KEYFILE]':<32} a controller in any language; with a key on any machine"
    )
    print("use: kontur-av joystick test --device SPEC, kontur-av stream --joystick SPEC")
    return 0


def _test(spec: str, check: str, report: Path | None) -> int:
    check_writable(report)
    if spec == PAGE:
        raise ConfigError(
            "--device page: a page moves it in a session only, with `kontur-av stream --joystick "
            "page`; its mechanics are those of sim: test that"
        )
    say_unprotected(spec)
    device = open_device(spec)
    console = Console()
    bench = CheckBench(device, list(CHECKS) if check == _ALL else [check])
    try:
        if is_simulated(spec):
            seconds = _run_virtually(bench)
            console.print(f"{device.facts.name}, {seconds:.0f} s of virtual time", highlight=False)
        else:
            console.print(f"{device.facts.name}; Ctrl-C ends", highlight=False)
            seconds = _run_live(bench, device, console)
    finally:
        device.close()
    transitions: list[Transition] = []
    while (transition := bench.operation.next_event()) is not None:
        transitions.append(transition)
    with output_that_may_fail():
        console.print(results_table(bench.results))
        for result in bench.results:
            if words := result.trouble or result.skipped:
                console.print(f"{result.name}: {words}", highlight=False, soft_wrap=True)
        if not bench.done:
            console.print(f"ended before {bench.current} was done", highlight=False)
    if report is not None:
        write_report(report, _report(spec, bench, transitions, seconds))
    return 1 if not bench.done or any(result.failed for result in bench.results) else 0


def _run_virtually(bench: CheckBench) -> float:
    now_ns = 0
    while not bench.done and now_ns < _LONGEST_NS:
        now_ns += _CYCLE_NS
        bench.handle_cycle(now_ns, _CYCLE_NS)
    return now_ns / NS_PER_S


def _run_live(bench: CheckBench, device: JoystickDevice, console: Console) -> float:
    clock = MonotonicClock()
    began_ns = clock.now_ns()
    schedule = PeriodicSchedule(start_ns=began_ns, period_ns=_CYCLE_NS)
    prompt = ""
    now_ns = began_ns
    with stopped_by_signals() as stopped:
        while not bench.done and not stopped() and now_ns - began_ns < _LONGEST_NS:
            clock.sleep_until_ns(schedule.next_deadline_ns)
            now_ns = clock.now_ns()
            if schedule.handle_wakeup(now_ns) < 0:
                continue
            bench.handle_cycle(now_ns, schedule.advance_ns)
            if bench.prompt != prompt:
                prompt = bench.prompt
                if prompt:
                    console.print(prompt, highlight=False)
    return (now_ns - began_ns) / NS_PER_S


def results_table(results: list[CheckResult]) -> Table:
    """The figures of checks with their limits, for a terminal."""
    table = Table(title="Functional checks", title_justify="left")
    for name in ("check", "figure"):
        table.add_column(name)
    for name in ("measured", "least", "most"):
        table.add_column(name, justify="right")
    table.add_column("")
    for result in results:
        if result.skipped:
            table.add_row(result.name, "", "", "", "", "skipped")
        elif not result.figures:
            table.add_row(result.name, "", "", "", "", _verdict(result.passed))
        for index, figure in enumerate(result.figures):
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


def _report(
    spec: str, bench: CheckBench, transitions: list[Transition], seconds: float
) -> JoystickTestReport:
    return JoystickTestReport(
        device=spec,
        virtual_time=is_simulated(spec),
        seconds=round(seconds, 3),
        passed=bench.done and not any(result.failed for result in bench.results),
        checks=[_check(result) for result in bench.results],
        joystick=bench.operation.report(),
        transitions=[
            TransitionReport(
                s=round(transition.now_ns / NS_PER_S, 3) if is_simulated(spec) else None,
                before=transition.before.words,
                event=transition.event.value,
                after=transition.after.words,
                reason=transition.reason,
            )
            for transition in transitions
        ],
    )


def _check(result: CheckResult) -> CheckReport:
    return CheckReport(
        name=result.name,
        passed=None if result.skipped else result.passed,
        trouble=result.trouble,
        skipped=result.skipped,
        figures=[
            FigureReport(
                name=figure.name,
                value=_rounded(figure.value),
                unit=figure.unit,
                least=_rounded(figure.least),
                most=_rounded(figure.most),
                passed=figure.passed,
            )
            for figure in result.figures
        ],
    )


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 6)
