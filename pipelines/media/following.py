"""How the uplink video's sender follows the selected camera, and the tip of the stylus. Cores."""

from collections.abc import Mapping
from dataclasses import replace
from itertools import count
from typing import NamedTuple

from kontur_av.clock import NS_PER_MS
from kontur_av.codecs.region import Focus, Region
from kontur_av.media import CaptureStamp, Tip, Tips
from pipelines.session.setup.table import Setup
from pipelines.session.topic import Topic
from telepresence.world.board import BoardView

#: A choice and its confirmation are told again after this time.
AGAIN_NS = 100 * NS_PER_MS


class Choice(NamedTuple):
    """Which camera is selected, and where a person wants its picture finest; None: nowhere.

    number: grows with each choice, also when the selector restarts.
    """

    number: int
    camera: str
    focus: Focus | None = None


#: The camera that the sender of the uplink video must follow, and the choice that it has confirmed.
SELECTED_TOPIC = Topic[Choice]("selected/uplink_video", Choice, "the selected camera")
FOLLOWED_TOPIC = Topic[int](
    "followed/uplink_video", int, "number of the choice that the sender follows"
)
ROBOT_TIPS_TOPIC = Topic[Tips](
    "robot/tips", Tips, "where the robot's driver sees its tip, by camera"
)


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


#: A robot's state that is older may be wrong. Drivers say less often where they see the tip.
_STALE_NS = 200 * NS_PER_MS
TIP_EVERY_NS, _TIP_STALE_NS = 200 * NS_PER_MS, 600 * NS_PER_MS
#: The sides of the region around a tip, as a share of the picture's longer side: 96 of 640 pixels.
_SHARE = 0.15


class FocusRegion:
    """Where pictures are coded finer: where a person says, else around the tip. A core.

    person: the rectangle that a person has chosen.
    views: by camera, where the board is in its pictures. width, height: of pictures, in pixels.
    focused: pictures that had a region; newest: that of the last picture.
    """

    def __init__(self, views: Mapping[str, BoardView], *, width: int, height: int) -> None:
        self.person: Focus | None = None
        self.newest: Focus | None = None
        self.focused = 0
        self._views, self._width, self._height = dict(views), width, height
        side = _SHARE * max(width, height)
        self._size = side / width, side / height
        self._tip_m: tuple[float, float] | None = None
        self._seen_ns = 0
        #: By camera: where a driver sees the tip, and since when.
        self._tips: dict[str, tuple[Tip, int]] = {}

    def handle_tip(self, x_m: float, y_m: float, seen_ns: int) -> None:
        """The tip was at this place of the board (metres) at `seen_ns`."""
        self._tip_m, self._seen_ns = (x_m, y_m), seen_ns

    def handle_tips(self, tips: Tips, seen_ns: int) -> None:
        """A driver says where the tip is in the pictures of these cameras."""
        self._tips |= {camera: (tip, seen_ns) for camera, tip in tips.items()}

    def region(self, camera: str | None, now_ns: int) -> Region | None:
        """Return the region for a picture of `camera`; None without one."""
        self.newest = focus = self.person or self._around_tip(camera, now_ns)
        if focus is None:
            return None
        self.focused += 1
        return focus.region(self._width, self._height)

    def _around_tip(self, camera: str | None, now_ns: int) -> Focus | None:
        """None if the tip is not known, or outside of the picture."""
        if camera is None:
            return None
        tip, seen_ns = self._tips.get(camera, (None, 0))
        if tip is None or now_ns - seen_ns > _TIP_STALE_NS:
            tip = self._projected(camera, now_ns)
        if tip is None or not (0 <= tip.x <= 1 and 0 <= tip.y <= 1):
            return None
        return Focus.around(*tip, *self._size)

    def _projected(self, camera: str, now_ns: int) -> Tip | None:
        """Where the robot's tip is by what is known of the camera."""
        view = self._views.get(camera)
        if view is None or self._tip_m is None or now_ns - self._seen_ns > _STALE_NS:
            return None
        pixel = view.pixel(*self._tip_m)
        return None if pixel is None else Tip(pixel[0] / self._width, pixel[1] / self._height)


def focus_region(setup: Setup) -> FocusRegion:
    """Return what finds the regions of a setup's uplink video."""
    stream = setup.uplink_video
    views = {}
    for camera in setup.cameras if setup.region == "stylus" else ():
        view = board_view(setup, camera)
        if view is not None:
            views[camera] = view
    return FocusRegion(views, width=stream.width, height=stream.height)


def board_view(setup: Setup, camera: str) -> BoardView | None:
    """Return where the board is in a camera's pictures, as far as it is known.

    Points of the setup come first, then the built-in scenes. The scene `head` turns by up to 2 %
    of the picture's width, which is left out here.
    """
    if camera in setup.region_points:
        return BoardView.from_corners(setup.region_points[camera])
    scene = setup.board_scene(camera)
    if scene is None:
        return None
    # Imported late: OpenCV takes longer to load than all the rest of a sender.
    from telepresence.world.ground_views import camera_of

    stream = setup.uplink_video
    return BoardView(camera_of(scene, stream.width, stream.height).plane_homography())
