"""Selection of one camera of several by telecommand."""

from collections.abc import Sequence
from dataclasses import dataclass

from kontur_av.errors import ConfigError, ProtocolError


@dataclass(frozen=True, slots=True)
class CameraSelection:
    """Result of `select camera`: the selected camera, since when, and the previous one."""

    camera: str
    previous: str
    since_ns: int
    changed: bool


class Selector:
    """Selects one camera of several; the last command wins. A core.

    cameras: their names. selected: the first one; ConfigError if it is not among `cameras`.
    switches: number of real changes. refused: commands that named no known camera.
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

    def handle_select(self, name: str, now_ns: int) -> CameraSelection:
        """Select the camera `name`; selecting the selected one changes nothing.

        Raises ProtocolError, with the known names, for an unknown camera.
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
        return CameraSelection(name, previous, self._since_ns, changed)
