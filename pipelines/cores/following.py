"""How the sender of a picture follows the camera that is selected."""

import struct
from dataclasses import replace
from itertools import count
from typing import NamedTuple

from kontur_av.media import CaptureStamp

_NUMBER = struct.Struct("=q")
#: A choice with the longest name of a camera (`telepresence.tmtc.check_name`), and a confirmation.
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
        """What `pack` packed."""
        number: int = _NUMBER.unpack_from(data)[0]
        return cls(number, data[_NUMBER.size :].decode("ascii"))


def pack_confirmed(number: int) -> bytes:
    """The number of a confirmed choice as `CONFIRMED_OCTETS` octets for the selector."""
    return _NUMBER.pack(number)


def unpack_confirmed(data: bytes) -> int:
    """What `pack_confirmed` packed."""
    number: int = _NUMBER.unpack(data)[0]
    return number


class CameraFollower:
    """The sender's side of a choice: which camera it takes, and when it has done with another one.

    When `handle_choice` returns True, take pictures of `camera` alone, and drop a picture that
    waits to be coded. Code no picture while `leaving`. Tell with `handle_sender` when nothing of
    the camera before is being coded or waits to be sent. Then `confirmed` is the choice's number.

    A sender that was killed begins without a camera: nothing of it can follow, so it confirms the
    first choice that it hears of.
    """

    def __init__(self) -> None:
        self.camera: str | None = None
        self.leaving = False
        self._number: int | None = None
        self._pictures = count()

    def handle_choice(self, choice: Choice) -> bool:
        """The selector says what is selected; whether that is another camera than before."""
        if choice.number == self._number:
            return False
        self._number = choice.number
        if choice.camera == self.camera:
            return False
        self.leaving = self.camera is not None
        self.camera = choice.camera
        return True

    def handle_sender(self, *, idle: bool) -> bool:
        """idle: nothing is being coded, nothing waits to be sent. True if that ends `leaving`."""
        ends = self.leaving and idle
        if ends:
            self.leaving = False
        return ends

    @property
    def confirmed(self) -> int | None:
        """The number of the choice since which nothing of another camera is coded or sent."""
        return None if self.leaving else self._number

    def restamp(self, stamp: CaptureStamp) -> CaptureStamp:
        """The stamp of a picture that is taken: its sequence counts those of all cameras."""
        return replace(stamp, sequence=next(self._pictures))
