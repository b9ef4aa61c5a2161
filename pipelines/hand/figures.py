"""What the ends of haptics count beside their samples (`telepresence.haptics.figures`)."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class WallFigures:
    """A joystick that renders the wall of the robot's side (`--hand mediated`)."""

    #: Messages with a wall, or with none, that were taken.
    walls: int = 0
    #: Messages that were not newer than one before.
    walls_stale: int = 0
    #: Datagrams that are not such a message.
    walls_garbage: int = 0
