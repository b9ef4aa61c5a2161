"""Runs a study: keeps its files, serves its page, and moves the handle in real time. A shell."""

import asyncio
import csv
import fcntl
import hashlib
import io
import os
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import astuple, fields
from importlib.util import find_spec
from pathlib import Path

import msgspec
import numpy as np
from aiohttp import web

from kontur_av.clock import MonotonicClock
from kontur_av.closing import Closing
from kontur_av.errors import ConfigError, ProtocolError, refused
from pipelines.recording.export.columns import Column
from pipelines.recording.export.table_files import write_v5
from pipelines.report.report_file import write_text
from pipelines.seats.open_page import MessageRate
from pipelines.seats.seat_sockets import Message, SeatSocket, SeatSockets
from pipelines.session.access import VIEWER_WORDS, AccessError, AccessKind, Found, Role
from pipelines.session.page_messages import MOST_SEAT_OCTETS, parse_seat_message
from pipelines.session.page_sockets import PageListener
from pipelines.session.web_site import WebSite
from pipelines.study.effects import StudyReport, account_of_study
from pipelines.study.plan import StudyPlan, TrialResult
from pipelines.study.trials import StudyTrials, parse_press
from telepresence.haptics.device.device import JoystickDevice
from telepresence.haptics.device.page import PageDevice, PageInput
from telepresence.toml_file import read_toml, typed

_FILE = "trials.jsonl"
_NAMES = tuple(field.name for field in fields(TrialResult))


class _Head(msgspec.Struct, frozen=True, kw_only=True):
    """The first line of the trials: of which study they are. digest: of its plan. by: whom."""

    study: str
    digest: str
    by: str


def load_study(path: Path) -> StudyPlan:
    """The plan in a file. ConfigError names file and fix."""
    table = read_toml(path, "study")
    with refused(f"study {path}", ConfigError):
        return typed(table, StudyPlan, "a study")


def check_scipy() -> None:
    """ConfigError without what effects are computed with."""
    if find_spec("scipy") is None:
        raise ConfigError("the effects need scipy: pip install 'kontur-av[study]'")


class StudyFolder(Closing):
    """The folder of a study's results, held by one command at a time. ConfigError.

    results: of all trials that have finished. simulated: they are of simulated hands, and those
    that are there are thrown away.
    """

    def __init__(self, path: Path, plan: StudyPlan, *, simulated: bool = False) -> None:
        self._path = path / _FILE
        digest = hashlib.sha256(msgspec.json.encode(plan)).hexdigest()[:16]
        by = "simulated hands" if simulated else "people"
        head = _Head(study=plan.name, digest=digest, by=by)
        try:
            path.mkdir(parents=True, exist_ok=True)
            self._file = self._path.open("a+b")
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ConfigError(f"{path}: another command has this study: end it first") from None
        except OSError as error:
            raise ConfigError(f"{path}: cannot be written: {error.strerror or error}") from None
        self.results = self._read(head, fresh=simulated)
        if self._file.seek(0, os.SEEK_END) == 0:
            self._append(msgspec.json.encode(head))

    def close(self) -> None:
        self._file.close()

    @property
    def finished(self) -> Counter[int]:
        """How many trials of each participant have finished."""
        return Counter(result.participant for result in self.results)

    def add(self, result: TrialResult) -> None:
        """Keep a trial; it is on the disk when this returns."""
        self.results.append(result)
        self._append(msgspec.json.encode(result))

    def _append(self, line: bytes) -> None:
        self._file.write(line + b"\n")
        self._file.flush()
        os.fsync(self._file.fileno())

    def _read(self, head: _Head, *, fresh: bool) -> list[TrialResult]:
        self._file.seek(0)
        octets = self._file.read()
        # A line that was being written when the power failed is no trial.
        whole = octets.rfind(b"\n") + 1
        self._file.truncate(whole)
        lines = octets[:whole].splitlines()
        if not lines:
            return []
        try:
            found = msgspec.json.decode(lines[0], type=_Head)
            results = [msgspec.json.decode(line, type=TrialResult) for line in lines[1:]]
        except msgspec.DecodeError as error:
            raise ConfigError(f"{self._path}: no trials of a study ({error})") from None
        if found.by != head.by:
            raise ConfigError(f"{self._path} is of {found.by}: name another folder by --results")
        if fresh:
            self._file.truncate(0)
            return []
        if found != head:
            raise ConfigError(
                f"{self._path} is of study {found.study} with another plan: take the plan that it "
                "was made with, or another folder by --results"
            )
        return results


def write_tables(path: Path, results: Sequence[TrialResult], report: StudyReport) -> list[Path]:
    """Write trials and effects as CSV and as one MATLAB file, and the account; their paths."""
    trials = [_NAMES, *(astuple(result) for result in results)]
    names = tuple(field.name for field in fields(report.effects[0])) if report.effects else ()
    effects = [names, *(astuple(effect) for effect in report.effects)]
    found = [path / name for name in ("trials.csv", "effects.csv", "study.mat", "report.html")]
    with refused(f"{path}: cannot be written"):
        for file, table in zip(found, (trials, effects), strict=False):
            text = io.StringIO()
            csv.writer(text).writerows(table)
            write_text(file, text.getvalue())
        write_v5(found[2], {"trials": _columns(results)})
        write_text(found[3], account_of_study(report))
    return found


def _columns(results: Sequence[TrialResult]) -> dict[str, Column]:
    """A column for each field; NaN where a trial has no such figure."""
    found: dict[str, Column] = {}
    for name in _NAMES:
        values = [getattr(result, name) for result in results]
        texts = values if all(isinstance(value, str) for value in values) else None
        found[name] = np.array(values, np.float64) if texts is None else texts
    return found


_TICK_S = 0.004
#: Motors get a new force once a millisecond.
_MOTOR_TICK_S = 0.001
#: Messages of a page; a pointer moves up to 1000 times a second, as a seat permits.
_RATE_HZ, _BURST = 1200, 400
#: In the private range of close codes (RFC 6455 section 7.4.2): another page has the study.
_TAKEN_OVER = 4001


class _Page:
    """The one page that has the study. screen: the last that it was sent."""

    def __init__(self, socket: SeatSocket) -> None:
        self.socket = socket
        self.rate = MessageRate(_RATE_HZ, _BURST)
        self.wake = asyncio.Event()
        self.screen = -1


class StudyServer:
    """Call `run`. keep: called with each trial that has finished. device: the handle."""

    def __init__(
        self,
        service: StudyTrials,
        device: JoystickDevice,
        listener: PageListener,
        keep: Callable[[TrialResult], None],
    ) -> None:
        self._service, self._device, self._keep = service, device, keep
        self._tick_s = _TICK_S if isinstance(device, PageDevice) else _MOTOR_TICK_S
        self._now_ns = MonotonicClock().now_ns
        self._site = WebSite(listener, seat="study")
        self._sockets = SeatSockets(self._now_ns)
        self._page: _Page | None = None

    async def run(self) -> None:
        """Serve until it is cancelled."""
        async with self._site.served("pipelines.study", self._answer, self._sockets.close):
            while True:
                self._tick()
                await asyncio.sleep(self._tick_s)

    def _tick(self) -> None:
        now_ns = self._now_ns()
        self._service.handle_time(now_ns)
        self._sockets.handle_time(now_ns)
        while (result := self._service.next_result()) is not None:
            self._keep(result)
        if self._page is not None:
            self._page.wake.set()

    async def _answer(self, request: web.BaseRequest, found: Found) -> web.StreamResponse:
        if found.kind is not AccessKind.SEAT:
            return self._site.file(request, found)
        if found.role is Role.VIEWER:
            raise AccessError(403, VIEWER_WORDS, "role")
        socket = await self._sockets.open(request, MOST_SEAT_OCTETS)
        last, page = self._page, _Page(socket)
        self._page = page
        if last is not None:
            await last.socket.close(_TAKEN_OVER, "another page has this study")

        async def next_message() -> Message:
            while True:
                await page.wake.wait()
                page.wake.clear()
                shown, frame = self._service.show(self._now_ns()), self._service.frame
                if shown.screen != page.screen:
                    page.screen = shown.screen
                    return msgspec.json.encode(shown).decode()
                if frame is not None:
                    return msgspec.json.encode(frame).decode()

        def take(message: Message) -> None:
            self._take(page, message)

        try:
            await self._sockets.serve(socket, take, next_message)
        finally:
            if self._page is page:
                self._page = None
        return socket.ws

    def _take(self, page: _Page, message: Message) -> None:
        now_ns = self._now_ns()
        if not page.rate.handle_message(now_ns):
            raise ProtocolError("too many messages")
        if page is not self._page:
            return
        if isinstance(message, str):
            self._service.handle_press(parse_press(message), now_ns)
            return
        hand = parse_seat_message(message, now_ns)
        # With a handle of its own a page only shows.
        if isinstance(hand, PageInput) and isinstance(self._device, PageDevice):
            self._device.handle_input(hand)
