"""Which camera goes on."""

from collections.abc import Sequence
from dataclasses import dataclass

from kontur_av.errors import ConfigError, ProtocolError


@dataclass(frozen=True, slots=True)
class Selection:
    """What a `select camera` did: the camera that goes on now, since when, and after which."""

    camera: str
    previous: str
    since_ns: int
    changed: bool


class Selector:
    """Core: one camera of several is selected, the last command wins.

    cameras: their names. selected: the one to begin with. Raises ConfigError when it is none
    of them. switches counts real changes, refused the commands that named no camera.
    """

    def __init__(self, cameras: Sequence[str], selected: str) -> None:
        self.cameras = tuple(cameras)
        if selected not in self.cameras:
            raise ConfigError(
                f"camera {selected!r} is unknown; choose one of {', '.join(self.cameras)}"
            )
        self._selected = selected
        self._since_ns = 0
        self.switches = 0
        self.refused = 0

    @property
    def selected(self) -> str:
        return self._selected

    def handle_select(self, name: str, now_ns: int) -> Selection:
        """A telecommand asks for camera `name`. Selecting the selected one changes nothing.

        Raises ProtocolError, with the known names, for a camera that does not exist.
        """
        if name not in self.cameras:
            self.refused += 1
            raise ProtocolError(
                f"camera {name!r} is unknown; choose one of {', '.join(self.cameras)}"
            )
        previous, changed = self._selected, name != self._selected
        if changed:
            self._selected = name
            self._since_ns = now_ns
            self.switches += 1
        return Selection(name, previous, self._since_ns, changed)
