"""The files on their way, as the systems operator's page shows them. A core."""

import re
from typing import Final

from kontur_av.clock import NS_PER_S
from pipelines.seats.texts import TransferText
from pipelines.session.setup.segments import Segment

#: A line of the list: number, kind, state, octets with the size if it is known, and the name.
_LINE: Final = re.compile(r"(\d+) +(\w+) +(\w+) +(\d+)(?: of (\d+))?  (.*)")


class Transfers:
    """The files on their way that were asked for here, with the rate since the last look."""

    def __init__(self) -> None:
        self._before: dict[tuple[Segment, int], tuple[int, int]] = {}

    def handle_list(self, segment: Segment, text: str, now_ns: int) -> list[TransferText]:
        """text: what `kontur-av file status` prints at an end."""
        found, before = [], self._before
        self._before = {key: was for key, was in before.items() if key[0] is not segment}
        for line in filter(None, map(_LINE.fullmatch, text.splitlines())):
            number, octets = int(line[1]), int(line[4])
            was_octets, was_ns = before.get((segment, number), (octets, now_ns - 1))
            self._before[segment, number] = octets, now_ns
            rate_bps = max(0, 8 * (octets - was_octets) * NS_PER_S // max(1, now_ns - was_ns))
            found.append(
                TransferText(
                    end=segment.value,
                    number=number,
                    what=line[2],
                    state="queued" if line[3] == "waiting" else line[3],
                    octets=octets,
                    size=None if line[5] is None else int(line[5]),
                    rate_bps=rate_bps,
                    name=line[6],
                )
            )
        return found
