"""The files on their way, as the systems operator's page shows them. A core."""

from collections.abc import Iterable

from kontur_av.clock import NS_PER_S
from pipelines.seats.texts import TransferText
from pipelines.session.file_requests import TransferNow
from pipelines.session.setup.segments import Segment
from telepresence.files.entity import WAITING


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
