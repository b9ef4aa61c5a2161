"""Requests to a session's recorder and its answers, as lines of JSON. A core.

Request: `{"record": "start", "file": "/home/me/run.mcap"}`, `{"record": "stop"}` or
`{"record": "state"}`. Answer: `{"ok": true, "file": ...}` or `{"ok": false, "error": "..."}`;
`mistake` means that the request itself was wrong.
"""

from dataclasses import dataclass

import msgspec

from kontur_av.clock import NS_PER_S

START, STOP, STATE = "start", "stop", "state"


@dataclass(frozen=True, kw_only=True)
class PartLimits:
    """When a new part begins: after `ns`, or with `octets`."""

    ns: int = 600 * NS_PER_S
    octets: int = 256_000_000


class RecordingWish(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What is to be recorded, and into which file.

    file: absolute path of the first part. link_frames: with every frame of the radio link.
    part_s, part_mb: when a new part begins. command: the command line that wished it.
    held: end the recording when its terminal has gone.
    """

    file: str
    link_frames: bool = False
    part_s: float = 600.0
    part_mb: float = 256.0
    command: str = ""
    held: bool = False

    @property
    def limits(self) -> PartLimits:
        return PartLimits(ns=round(self.part_s * NS_PER_S), octets=round(self.part_mb * 1e6))


class RecordRequest(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A request. overwrite: replace a recording that is there."""

    record: str
    wish: RecordingWish | None = None
    overwrite: bool = False


class RecordAnswer(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """An answer. files: how many parts there are. lost: messages that are in none of them."""

    ok: bool
    error: str = ""
    mistake: bool = False
    file: str = ""
    files: int = 0
    messages: int = 0
    lost: int = 0
    fault: str = ""
