"""When a camera gives a preview, and in which size. A core."""

from kontur_av.clock import NS_PER_MS

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
