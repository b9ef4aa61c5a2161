"""Asks the session's processes for what the systems operator's page shows: files and software."""

import asyncio
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

import msgspec

from kontur_av.clock import NS_PER_S
from pipelines.seats.seat import Seat
from pipelines.seats.texts import SoftwareText, TransferText, UpkeepText
from pipelines.session.requests import ask_async
from pipelines.session.serving_loop import ServingLoop
from pipelines.session.session_metrics import gathered
from pipelines.session.setup.segments import Segment
from pipelines.session.transfer_requests import (
    STATUS,
    FileAnswer,
    FileRequest,
    TransferNow,
    socket_name,
)
from telepresence.files.entity import WAITING
from telepresence.files.pdus import GET
from telepresence.malformed import MALFORMED
from telepresence.upkeep.inbox import LARGEST_TOLD, TOLD, InboxTold


class Transfers:
    """The files on their way that were asked for here, with the rate since the last look."""

    def __init__(self) -> None:
        self._before: dict[tuple[Segment, int], tuple[int, int]] = {}

    def handle_list(
        self, segment: Segment, listed: Iterable[TransferNow], now_ns: int
    ) -> list[TransferText]:
        """Return the rows for the page. listed: the transfers of an end, as it answered."""
        found, before = [], self._before
        self._before = {key: was for key, was in before.items() if key[0] is not segment}
        for one in listed:
            was_octets, was_ns = before.get((segment, one.number), (one.octets, now_ns - 1))
            self._before[segment, one.number] = one.octets, now_ns
            rate_bps = max(0, 8 * (one.octets - was_octets) * NS_PER_S // max(1, now_ns - was_ns))
            found.append(
                TransferText(
                    end=segment.value,
                    number=one.number,
                    what=one.kind,
                    state="queued" if one.state == WAITING else one.state,
                    octets=one.octets,
                    size=None if one.size < 0 else one.size,
                    rate_bps=rate_bps,
                    name=one.first,
                )
            )
        return found


_EVERY_NS: Final = NS_PER_S
#: The folder of fetched files, below the directory of the ground.
FETCHED: Final = "fetched"
_MOST_INBOXES: Final = 16


async def fetch(session: str, segment: Segment, inbox: str) -> None:
    """Begin to fetch the status of a keeper at the other end; errors as of `ask_async`."""
    request = FileRequest(file=GET, first=f"{inbox}/{TOLD}", second=f"{FETCHED}/{inbox}/{TOLD}")
    await ask_async(session, socket_name(segment), request, FileAnswer)


def software_in(directory: Path, end: str) -> Iterator[SoftwareText]:
    """Yield the status of each keeper with an inbox below a directory, if it can be read."""
    with suppress(OSError):
        for path in sorted(directory.glob(f"*/{TOLD}"))[:_MOST_INBOXES]:
            # A link may lead out of the directory.
            if path.is_symlink() or path.parent.is_symlink() or not path.is_file():
                continue
            with suppress(OSError, *MALFORMED):
                descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
                with os.fdopen(descriptor, "rb") as file:
                    written_s = os.fstat(descriptor).st_mtime
                    told = msgspec.json.decode(file.read(LARGEST_TOLD), type=InboxTold)
                yield gathered(
                    SoftwareText,
                    told,
                    end=end,
                    inbox=path.parent.name,
                    written=f"{datetime.fromtimestamp(written_s, UTC):%Y-%m-%d %H:%M:%S}",
                    answers=tuple(
                        f"{answer.file}: {'taken' if answer.taken else 'refused'}, {answer.text}"
                        for answer in told.answers
                    ),
                )


class UpkeepWatch:
    """Asks once a second while somebody watches. directories: of the ends that run here."""

    def __init__(
        self,
        session: str,
        seat: Seat,
        serving: ServingLoop,
        directories: Mapping[Segment, Path],
        now_ns: Callable[[], int],
    ) -> None:
        self._session, self._seat, self._serving = session, seat, serving
        self._directories, self._now_ns = directories, now_ns
        self._transfers = Transfers()
        self._due_ns = 0
        self._asks = False
        seat.handle_shown("upkeep", UpkeepText(files=bool(directories)))

    def look(self, now_ns: int) -> None:
        """Begin to ask, if the last time was a second ago."""
        if self._directories and not self._asks and now_ns >= self._due_ns:
            self._due_ns, self._asks = now_ns + _EVERY_NS, True
            self._serving.begin(self._ask())

    async def _ask(self) -> None:
        transfers: list[TransferText] = []
        for segment in self._directories:
            listed: tuple[TransferNow, ...] = ()
            with suppress(OSError):
                name, request = socket_name(segment), FileRequest(file=STATUS)
                listed = (await ask_async(self._session, name, request, FileAnswer)).transfers
            transfers += self._transfers.handle_list(segment, listed, self._now_ns())
        # A slow disk must not hold up what other pages are sent.
        software = await asyncio.to_thread(lambda: tuple(self._software()))
        shown = UpkeepText(files=True, transfers=tuple(transfers), software=software)
        self._seat.handle_shown("upkeep", shown)
        self._asks = False

    def _software(self) -> Iterator[SoftwareText]:
        for segment, directory in self._directories.items():
            yield from software_in(directory, segment.value)
        if Segment.SPACE not in self._directories:
            yield from software_in(self._directories[Segment.GROUND] / FETCHED, "space")
