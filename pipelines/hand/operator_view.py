"""Whether what the operator sees is too old to move a robot by. A core."""

from collections.abc import Callable

from kontur_av.clock import NS_PER_S
from kontur_av.streams.staleness import FUTURE_NS
from pipelines.session.setup.table import Setup


class OperatorView:
    """The age of the uplink's picture where it is shown.

    A display that shows nothing, or is gone, lets the last picture age. Before the first picture
    everything is too old.
    """

    def __init__(self, setup: Setup) -> None:
        granted_ns = round(setup.safety.picture_max_age_s * NS_PER_S)
        self._most_ns = setup.stale_after_ns(setup.uplink_video) + granted_ns
        self._captured_ns: int | None = None

    def handle_shown(self, shown_ns: int, lag_ns: int) -> None:
        """A picture was shown at `shown_ns`, `lag_ns` after it was captured.

        One from the future has an age that nobody knows.
        """
        self._captured_ns = shown_ns - lag_ns if lag_ns >= -FUTURE_NS else None

    def is_blind(self, now_ns: int) -> bool:
        """Whether the picture is too old, or there is none."""
        return self._captured_ns is None or now_ns - self._captured_ns > self._most_ns


class CameraWatch:
    """At the robot: a change of the selected camera, and the frozen half of a merged picture.

    `changed` is called at each change but the first.
    """

    def __init__(self, merged: str, stale_ns: int, changed: Callable[[], None]) -> None:
        self._merged, self._stale_ns, self._changed = merged, stale_ns, changed
        self._camera: str | None = None
        self._captured_ns: int | None = None

    def handle_choice(self, camera: str) -> None:
        """`camera` is selected."""
        if self._camera is not None and camera != self._camera:
            self._changed()
        self._camera = camera

    def handle_halves(self, captured_ns: int) -> None:
        """The older half of the newest merged picture was captured then."""
        self._captured_ns = captured_ns

    def is_blind(self, now_ns: int) -> bool:
        """Whether the operator looks at a merged picture of which a half is too old."""
        if self._camera != self._merged or self._captured_ns is None:
            return False
        return now_ns - self._captured_ns > self._stale_ns
