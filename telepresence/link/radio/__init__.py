"""Simulated radio between two gateways: delay, bit errors, bursts, blackouts and passes.

`load_radio(name or FILE.toml)` returns a `RadioProfile`. Its `path(direction, seed=, epoch_ns=)` is
a `RadioPath` for the frames of one direction. docs/radio.md has the equations.
"""

from telepresence.link.radio.contact import Contact
from telepresence.link.radio.path import RadioPath
from telepresence.link.radio.profile import (
    Blackout,
    Bursts,
    Direction,
    RadioProfile,
    RandomBlackouts,
    delayed,
    started,
)
from telepresence.link.radio.profile_file import load_radio

__all__ = [
    "Blackout",
    "Bursts",
    "Contact",
    "Direction",
    "RadioPath",
    "RadioProfile",
    "RandomBlackouts",
    "delayed",
    "load_radio",
    "started",
]
