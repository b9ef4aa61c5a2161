"""Which source an input takes, its own or a browser page; its figures and previews. A core."""

from typing import Self

from kontur_av.clock import NS_PER_MS
from kontur_av.media import BLOCK_NS, CaptureStamp
from pipelines.media.media_metrics import CaptureMetrics
from pipelines.session.probe import Probe

#: What a page gives is taken if it was captured no longer ago. So much later than the last of it
#: the input falls back to its own source.
PICTURE_FRESH_NS = 500 * NS_PER_MS
SOUND_FRESH_NS = 200 * NS_PER_MS
#: Two pictures closer than this would have one RTP timestamp, or nearly so.
_PICTURES_APART_NS = NS_PER_MS
#: The RTP sender takes a block that comes earlier for the block after a gap.
_BLOCKS_APART_NS = 3 * BLOCK_NS // 4


class Takeover:
    """Decides what of two sources an input takes, and gives each its stamp.

    While a page is live, nothing of the own source is taken. A page is live from the first fresh
    picture or block that it gives until `fresh_ns` after the last one came. Nothing is taken twice,
    out of order, or from the future.

    name: of the input; it stands in every stamp. Use `of_pictures` or `of_sound`.
    """

    def __init__(self, name: str, *, fresh_ns: int, apart_ns: int, unbroken: bool) -> None:
        self._name = name
        self._fresh_ns = fresh_ns
        self._apart_ns = apart_ns
        self._unbroken = unbroken
        self._live_until_ns: int | None = None
        self._last_ns: int | None = None
        #: The number that its source gave to what was taken last, and whether that was a page.
        self._last_number: int | None = None
        self._last_of_page = False
        self._taken = 0
        #: What pages gave and was taken, and what was not: too old, or before what was taken last.
        self.from_page = 0
        self.refused = 0

    @classmethod
    def of_pictures(cls, name: str) -> Self:
        """Of a camera: any picture may be left out."""
        return cls(name, fresh_ns=PICTURE_FRESH_NS, apart_ns=_PICTURES_APART_NS, unbroken=False)

    @classmethod
    def of_sound(cls, name: str) -> Self:
        """Of a microphone: the next block of a page is taken even if its stamp jitters."""
        return cls(name, fresh_ns=SOUND_FRESH_NS, apart_ns=_BLOCKS_APART_NS, unbroken=True)

    def poll_timeout(self) -> int | None:
        """Return when a page ceases to be live; None while none is."""
        return self._live_until_ns

    @property
    def live_source(self) -> str:
        """Whose turn it was when last asked: "page" or "own"."""
        return "own" if self._live_until_ns is None else "page"

    def live(self, now_ns: int) -> bool:
        """Whether a page has the input."""
        if self._live_until_ns is not None and now_ns >= self._live_until_ns:
            self._live_until_ns = None
        return self._live_until_ns is not None

    def handle_page(self, stamp: CaptureStamp, now_ns: int) -> CaptureStamp | None:
        """A page gave a picture or a block; return its stamp, or None if it is not taken.

        stamp: with the page's instant of capture, and the page's own count of them.
        """
        capture_ns = min(stamp.capture_ns, now_ns)
        if now_ns - capture_ns > self._fresh_ns:
            self.refused += 1
            return None
        self._live_until_ns = now_ns + self._fresh_ns
        follows = self._last_of_page and stamp.sequence - 1 == self._last_number
        if follows and self._unbroken and self._last_ns is not None:
            capture_ns = max(capture_ns, self._last_ns + 1)
        elif self._too_soon(capture_ns):
            self.refused += 1
            return None
        self.from_page += 1
        return self._take(stamp, capture_ns, of_page=True)

    def handle_unfit(self) -> None:
        """A page gave a picture of another size, or a block of another length."""
        self.refused += 1

    def handle_own(self, stamp: CaptureStamp, now_ns: int) -> CaptureStamp | None:
        """The own source gave one; return its stamp, or None if it is not taken."""
        if self.live(now_ns):
            return None
        if self._last_of_page and self._too_soon(stamp.capture_ns):
            return None
        return self._take(stamp, stamp.capture_ns, of_page=False)

    def _too_soon(self, capture_ns: int) -> bool:
        return self._last_ns is not None and capture_ns < self._last_ns + self._apart_ns

    def _take(self, stamp: CaptureStamp, capture_ns: int, *, of_page: bool) -> CaptureStamp:
        self._last_ns, self._last_number, self._last_of_page = capture_ns, stamp.sequence, of_page
        number, self._taken = self._taken, self._taken + 1
        if not of_page and number == stamp.sequence:
            return stamp
        return CaptureStamp(capture_ns, number, self._name)


class Capturing:
    """Counts the pictures or blocks of sound of a source."""

    def __init__(self, probe: Probe) -> None:
        self._probe = probe
        self._captured = 0
        self._last_ns: int | None = None

    def handle_captured(self, stamp: CaptureStamp) -> None:
        """The source captured a picture or a block of sound."""
        self._captured += 1
        self._last_ns = stamp.capture_ns

    def publish(
        self,
        faults: int = 0,
        last_fault: str = "",
        takeover: Takeover | None = None,
        dated_by: str | None = None,
    ) -> None:
        """Put the counters into the probe, with the faults that the source has survived.

        takeover: of the input, if pages can take it over. dated_by: of a `LiveCapture`.
        """
        self._probe.publish(
            CaptureMetrics(
                captured=self._captured,
                source_faults=faults,
                from_page=None if takeover is None else takeover.from_page,
                page_refused=None if takeover is None else takeover.refused,
                captured_ns=self._last_ns,
                source_fault=last_fault or None,
                live_source=None if takeover is None else takeover.live_source,
                dated_by=dated_by,
            )
        )


#: 5 a second.
PREVIEW_PERIOD_NS = 200 * NS_PER_MS
#: The largest preview, in pixels.
_WIDTH, _HEIGHT = 160, 120
#: No `I420` is smaller.
_LEAST = 16


def preview_size(width: int, height: int) -> tuple[int, int]:
    """Return width and height of the previews of pictures of this size, with the same aspect.

    They are rounded down to what an `I420` can have, and are never larger than the pictures.
    """
    if width * _HEIGHT > height * _WIDTH:
        small = min(_WIDTH, width), min(_WIDTH, width) * height // width
    else:
        small = min(_HEIGHT, height) * width // height, min(_HEIGHT, height)
    return max(_LEAST, small[0] & ~1), max(_LEAST, small[1] & ~3)


class Previewing:
    """Decides which pictures of a camera become previews: about 5 a second."""

    def __init__(self) -> None:
        self._due_ns: int | None = None

    def due(self, now_ns: int) -> bool:
        """Whether the next picture is to become a preview, if anybody looks."""
        return self._due_ns is None or now_ns >= self._due_ns

    def handle_preview(self, now_ns: int) -> None:
        if self._due_ns is None or now_ns - self._due_ns > PREVIEW_PERIOD_NS:
            # The first one, or the first after nobody looked.
            self._due_ns = now_ns
        self._due_ns += PREVIEW_PERIOD_NS
