"""Where the uplink video is coded finer: around the tip of the stylus."""

from collections.abc import Mapping

from kontur_av.clock import NS_PER_MS
from kontur_av.codecs.region import Region
from pipelines.session.setup.table import Setup
from telepresence.world.board import BoardView

#: A tip that was seen longer ago may be anywhere.
_STALE_NS = 200 * NS_PER_MS
#: The sides of the region, as a share of the picture's longer side: 96 of 640 pixels.
_SHARE = 0.15
#: docs/experiments/video.md: the tip gains 0.9 dB, the rest loses 0.1 to 0.4.
_STEPS = 4


class TipRegion:
    """The region of interest around the tip, for the camera that is selected. A core.

    views: by camera, where the board is in its pictures. A camera without a view has no region.
    width, height: size of the pictures in pixels.
    """

    def __init__(self, views: Mapping[str, BoardView], *, width: int, height: int) -> None:
        self._views = dict(views)
        self._side = round(_SHARE * max(width, height))
        self._tip_m: tuple[float, float] | None = None
        self._seen_ns = 0

    def handle_tip(self, x_m: float, y_m: float, seen_ns: int) -> None:
        """The tip was at this place of the board (metres) at `seen_ns`."""
        self._tip_m = x_m, y_m
        self._seen_ns = seen_ns

    def region(self, camera: str | None, now_ns: int) -> Region | None:
        """Return the region for a picture of `camera`; None without one.

        There is none if the camera has no view, if no tip is known or it is older than 0.2 s, or
        if the tip is behind the camera.
        """
        view = None if camera is None else self._views.get(camera)
        if view is None or self._tip_m is None or now_ns - self._seen_ns > _STALE_NS:
            return None
        pixel = view.pixel(*self._tip_m)
        if pixel is None:
            return None
        side = self._side
        left, top = (round(centre - side / 2) for centre in pixel)
        return Region(left, top, side, side, steps=_STEPS)


def tip_region(setup: Setup) -> TipRegion | None:
    """Return the region of a setup's uplink video; None if the setup wants none."""
    if setup.region == "off":
        return None
    stream = setup.uplink_video
    views = {}
    for camera in setup.cameras:
        view = board_view(setup, camera)
        if view is not None:
            views[camera] = view
    return TipRegion(views, width=stream.width, height=stream.height)


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
