"""How the sender of the uplink video follows the selected camera."""

import struct
from dataclasses import replace
from itertools import count
from typing import NamedTuple

from kontur_av.clock import NS_PER_MS
from kontur_av.media import CaptureStamp

#: A choice and its confirmation are told again after this time.
AGAIN_NS = 100 * NS_PER_MS
_NUMBER = struct.Struct("=q")
#: A choice with the longest name of a camera (`pipelines.session.setup.table`), and a confirmation.
CHOICE_OCTETS = _NUMBER.size + 255
CONFIRMED_OCTETS = _NUMBER.size


class Choice(NamedTuple):
    """Which camera is selected. number: grows with each choice, also when the selector restarts."""

    number: int
    camera: str

    def pack(self) -> bytes:
        """At most `CHOICE_OCTETS` octets for the sender."""
        return _NUMBER.pack(self.number) + self.camera.encode("ascii")

    @classmethod
    def unpack(cls, data: bytes) -> "Choice":
        number: int = _NUMBER.unpack_from(data)[0]
        return cls(number, data[_NUMBER.size :].decode("ascii"))


def pack_confirmed(number: int) -> bytes:
    """The number of a confirmed choice as `CONFIRMED_OCTETS` octets for the selector."""
    return _NUMBER.pack(number)


def unpack_confirmed(data: bytes) -> int:
    number: int = _NUMBER.unpack(data)[0]
    return number


class CameraFollower:
    """The sender's side of a selection: which camera it reads, and when the previous one is done.

    When `handle_choice` returns True, read pictures of `camera` only, and drop a picture that waits
    to be coded. Code no picture while `leaving`. Report with `handle_sender` when no picture of the
    previous camera is being coded or waits to be sent. Then tell the selector `poll_confirmed`.

    A restarted sender begins without a camera and can send nothing of an earlier one. So it
    confirms the first choice that it receives.
    """

    def __init__(self) -> None:
        self.camera: str | None = None
        self.leaving = False
        self._number: int | None = None
        self._told: tuple[int, int] | None = None
        self._pictures = count()

    def handle_choice(self, choice: Choice) -> bool:
        """The selector has reported the selected camera; True if it is another one than before."""
        if choice.number == self._number:
            return False
        self._number = choice.number
        if choice.camera == self.camera:
            return False
        self.leaving = self.camera is not None
        self.camera = choice.camera
        return True

    def handle_sender(self, *, idle: bool) -> bool:
        """The sender's state; True if it ends `leaving`.

        idle: nothing is being coded, and nothing waits to be sent.
        """
        ends = self.leaving and idle
        if ends:
            self.leaving = False
        return ends

    @property
    def confirmed(self) -> int | None:
        """The last choice's number; None until nothing is left of the previous camera."""
        return None if self.leaving else self._number

    def poll_confirmed(self, now_ns: int) -> int | None:
        """The number to tell the selector now, or None.

        It is told repeatedly, for a selector that has started since.
        """
        number = self.confirmed
        if number is None:
            return None
        told = self._told
        if told is not None and told[0] == number and now_ns - told[1] < AGAIN_NS:
            return None
        self._told = number, now_ns
        return number

    def restamp(self, stamp: CaptureStamp) -> CaptureStamp:
        """`stamp` with a sequence number that counts the pictures of all cameras."""
        return replace(stamp, sequence=next(self._pictures))
