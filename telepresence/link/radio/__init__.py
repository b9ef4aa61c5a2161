"""Simulated radio between two gateways: delay, bit errors, bursts, blackouts and passes.

`load_radio(name or FILE.toml)` returns a `RadioProfile`. Its `path(direction, seed=, epoch_ns=)` is
a `RadioPath` for the frames of one direction. docs/experiments/radio.md has the equations.
"""

from telepresence.link.radio.channel import Bursts as Bursts
from telepresence.link.radio.channel import RandomBlackouts as RandomBlackouts
from telepresence.link.radio.contact import Contact as Contact
from telepresence.link.radio.network import Network as Network
from telepresence.link.radio.path import RadioPath as RadioPath
from telepresence.link.radio.profile import Blackout as Blackout
from telepresence.link.radio.profile import Direction as Direction
from telepresence.link.radio.profile import RadioProfile as RadioProfile
from telepresence.link.radio.profile import delayed as delayed
from telepresence.link.radio.profile import started as started
from telepresence.link.radio.profile_file import load_radio as load_radio
