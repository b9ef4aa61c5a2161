"""Pictures, sound and haptics of a seat on their way to its pages."""

from collections.abc import Mapping, Sequence

from kontur_av.clock import NS_PER_US
from kontur_av.media import I420, CaptureStamp, Quality
from kontur_av.streams.coded_unit import CodedUnit
from pipelines.hand.haptic_trace import rows_of
from pipelines.media.unit_history import KeptUnit, UnitHistory
from pipelines.seats.open_page import OpenPage
from pipelines.seats.plan import SeatStream
from pipelines.seats.texts import Via
from pipelines.session.messages import (
    DAMAGED,
    KEY,
    REPLAYED,
    pack_haptic,
    pack_preview,
    pack_sound,
    pack_unit,
)


class SeatMedia:
    """Passes media on to pages, and replays units for a page whose decoder has to begin. A core.

    pages: those that are open, by number.
    """

    def __init__(self, streams: Sequence[SeatStream], pages: Mapping[int, OpenPage]) -> None:
        self._pages = pages
        self._histories = {
            each.index: UnitHistory(
                pictures=each.decoded_topic is not None, filmed=bool(each.filmed_topics)
            )
            for each in streams
            if each.via is not Via.SOUND
        }
        self._topics = {each.index: each.filmed_topics for each in streams}

    @property
    def lanes(self) -> list[int]:
        """Indices of the streams of pictures."""
        return list(self._histories)

    def handle_unit(self, stream: int, unit: CodedUnit, stamp: CaptureStamp, now_ns: int) -> None:
        history = self._histories[stream]
        kept = history.handle_unit(unit, stamp, now_ns)
        if kept is None or not self._pages:
            return
        message = _packed(stream, kept)
        for page in self._seeing():
            lane = page.queue.lane(stream)
            if lane.open or not page.idle:
                lane.put_unit(message, key=kept.key)
            else:
                self.replay(page)

    def handle_decoded(self, stream: int, key: bytes, rtp_timestamp: int) -> bool:
        """The picture of a unit, as a key unit. False: that unit is not known."""
        taken = self._histories[stream].handle_picture(key, rtp_timestamp)
        self._replay_idle()
        return taken

    def handle_filmed(self, stream: int, key: bytes, sequence: int) -> bool:
        """What was filmed for the unit of this number, as a key unit. False: it is not known."""
        taken = self._histories[stream].handle_filmed(key, sequence)
        self._replay_idle()
        return taken

    def wanted_pictures(self) -> list[int]:
        """Streams of which the shell is to fetch a decoded picture for `handle_decoded`."""
        return [index for index in self._joined() if self._histories[index].needs_picture]

    def wanted_filmed(self, camera: str | None) -> dict[int, str]:
        """By stream: the topic of pictures that the shell is to fetch for `handle_filmed`.

        camera: the selected one; None if it is not known.
        """
        if camera is None:
            return {}
        return {
            index: self._topics[index][camera]
            for index in self._joined()
            if self._histories[index].needs_filmed and camera in self._topics[index]
        }

    def handle_sound(self, stream: int, samples: bytes, stamp: CaptureStamp) -> None:
        message = pack_sound(
            stream,
            stamp.sequence,
            stamp.capture_ns // NS_PER_US,
            samples,
            concealed=stamp.quality is Quality.CONCEALED,
        )
        for page in self._seeing():
            page.queue.put_sound(stream, message)

    def handle_haptics(self, end: int, block: bytes) -> None:
        message = pack_haptic(end, rows_of(block))
        for page in self._seeing():
            page.queue.put_haptics(end, message)

    def handle_preview(self, preview: int, picture: I420, stamp: CaptureStamp) -> None:
        message = pack_preview(preview, stamp.capture_ns // NS_PER_US, picture)
        for page in self._seeing():
            page.queue.put_preview(preview, message)

    def replay(self, page: OpenPage) -> None:
        """Open the closed lanes of a page with what a decoder needs to begin now."""
        for stream in list(page.queue.closed_lanes()):
            units = self._histories[stream].replay()
            if units is not None:
                *before, last = units
                messages = [*(_packed(stream, unit, REPLAYED) for unit in before)]
                page.queue.lane(stream).put_replay([*messages, _packed(stream, last)])

    def _seeing(self) -> list[OpenPage]:
        """Pages with pictures, sound and haptics."""
        return [page for page in self._pages.values() if not page.plain]

    def _joined(self) -> list[int]:
        """Streams with units that a page waits for."""
        return [
            index
            for index in self._histories
            if any(not page.queue.lane(index).open for page in self._seeing())
        ]

    def _replay_idle(self) -> None:
        for page in self._pages.values():
            if page.idle:
                self.replay(page)


def _packed(stream: int, unit: KeptUnit, more_flags: int = 0) -> bytes:
    flags = KEY * unit.key | DAMAGED * unit.damaged | more_flags
    return pack_unit(stream, flags, unit.sequence, unit.capture_us, unit.data)
