"""Makes key pictures beside the loop of a process."""

from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor

from kontur_av.codecs.black_key import black_key
from kontur_av.media import I420
from pipelines.media.local_key import QUANTIZER, filmed_key, key_of, last_key

#: Of the key picture with which the codecs are loaded.
_SMALLEST = 16, 16


class KeyPictureMaker:
    """A thread with FFmpeg's codecs, so that no loop waits for a key picture.

    It loads the codecs at once, and makes one key picture after the other. Ask for the next one of
    a stream when the one before is there. So no more wait than there are streams.
    """

    def __init__(self) -> None:
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="key pictures")
        self._thread.submit(last_key, [black_key(*_SMALLEST)], *_SMALLEST)

    def of_picture(self, picture: I420, quantizer: int = QUANTIZER) -> "Future[bytes]":
        """Code a picture that nobody writes any more. quantizer: see `key_of`."""
        return self._thread.submit(key_of, picture, quantizer)

    def of_filmed(self, picture: I420, width: int, height: int) -> "Future[bytes]":
        """Code a camera's picture in the size in which a sender codes it."""
        return self._thread.submit(filmed_key, picture, width, height)

    def of_units(self, units: Sequence[bytes], width: int, height: int) -> "Future[bytes | None]":
        """Code the last picture of these access units anew; None if it has another size."""
        return self._thread.submit(last_key, units, width, height)

    def close(self) -> None:
        """Make no more; those that have not begun are given up."""
        self._thread.shutdown(wait=False, cancel_futures=True)
