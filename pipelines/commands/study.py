"""`kontur-av study`: how the handle changes what a hand can do, measured on this machine alone."""

import argparse
import asyncio
from contextlib import closing
from pathlib import Path
from tempfile import TemporaryDirectory

from rich.box import SIMPLE_HEAD
from rich.table import Table

from kontur_av.errors import ConfigError
from pipelines.commands.rtc_running import driven
from pipelines.report.report_file import WordsConsole
from pipelines.session.command_process import output_that_may_fail, say
from pipelines.session.option_rows import add_options
from pipelines.session.served_pages import bound_server, served
from pipelines.study.effects import HEADINGS, effect_words, study_report, summary_of
from pipelines.study.plan import StudyPlan
from pipelines.study.running import StudyFolder, StudyServer, check_scipy, load_study, write_tables
from pipelines.study.trials import StudyTrials, check_handle, simulate_person
from telepresence.haptics.device.device import JoystickDevice
from telepresence.haptics.device.page import PageDevice
from telepresence.haptics.specs import PAGE, open_alone

_PAGE = "study"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_options(
        parser,
        "plan PLAN.toml <Path>  handles, tasks and trials",
        "--simulated N <int>  simulated hands for the first N participants, on virtual time; then "
        "the report",
        "--seed S <int=0>  of the simulated hands (default 0)",
        "--report  show the effects; write HTML, CSV and a MATLAB file beside the trials",
        "--results DIR <Path>  the folder of the trials (default PLAN.results, or PLAN.simulated)",
        f"--joystick SPEC <={PAGE}>  the handle: page, udp:HOST:PORT[:KEYFILE] or your own "
        "module:Class, with motors; where it rests is its middle",
        "--page [HOST:]PORT  where the browser pages are served (default 127.0.0.1:8270, or the "
        "next free ports); TLS beyond loopback",
    )


def run(args: argparse.Namespace) -> int:
    """0 when the page is left by Ctrl-C, or the report is written."""
    plan, simulated = load_study(args.plan), args.simulated
    if simulated is not None and not 1 <= simulated <= plan.participants:
        raise ConfigError(
            f"--simulated {simulated}: the plan has {plan.participants} participants: give 1 to "
            f"{plan.participants}"
        )
    ending = ".results" if simulated is None else ".simulated"
    folder = args.results or args.plan.with_suffix(ending)
    if simulated is not None or args.report:
        check_scipy()
        if args.report and simulated is None and not folder.is_dir():
            raise ConfigError(f"{folder}: has no trials: do the study first, without --report")
    with StudyFolder(folder, plan, simulated=simulated is not None) as trials:
        if simulated is not None:
            for participant in range(1, simulated + 1):
                for result in simulate_person(plan, participant, args.seed):
                    trials.add(result)
                say(f"participant {participant} of {simulated} has finished")
        elif not args.report:
            with closing(_handle(args.joystick, plan)) as device:
                asyncio.run(_serve(args, plan, trials, device))
            return 0
        _report(folder, plan, trials)
    return 0


def _report(folder: Path, plan: StudyPlan, trials: StudyFolder) -> None:
    report = study_report(plan, trials.results)
    table = Table(*HEADINGS, box=SIMPLE_HEAD)
    for effect in report.effects:
        table.add_row(*effect_words(effect))
    with output_that_may_fail():
        for line in summary_of(report):
            print(line)
        WordsConsole().print(table)
    for path in write_tables(folder, trials.results, report):
        say(str(path))


def _handle(spec: str, plan: StudyPlan) -> JoystickDevice:
    """Open the handle of a study; ConfigError for one that cannot be."""
    if spec == PAGE:
        return PageDevice(start_m=(0.0, 0.0))
    device = open_alone(spec, axes=None)
    try:
        check_handle(plan, device)
    except ConfigError:
        device.close()
        raise
    reading = device.read()
    device.set_zero(reading.x_m, reading.y_m)
    return device


async def _serve(
    args: argparse.Namespace, plan: StudyPlan, trials: StudyFolder, device: JoystickDevice
) -> None:
    options = bound_server(args.page, _PAGE)
    with TemporaryDirectory() as place, served(options, Path(place), "page") as (found, made):
        listener = found[_PAGE]
        service = StudyTrials(plan, device, trials.finished)
        server = StudyServer(service, device, listener, trials.add)
        say(f"{listener.url(_PAGE)}\nCtrl-C ends it; it goes on where it was")
        if made:
            say(f"certificate made for this study, SHA-256 {made}")
        running = asyncio.create_task(server.run())
        try:
            async for _ in driven(None, running):
                pass
        finally:
            running.cancel()
            await asyncio.gather(running, return_exceptions=True)
