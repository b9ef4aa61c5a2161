"""Pictures of the robot's two cameras become one: cut at its seam, and marked where it is stale."""

from kontur_av.media import I420
from kontur_av.sources.seam import SeamFinder
from kontur_av.sources.stereo import StereoPair, merge
from pipelines.media.marking import mark_halves


class StereoMerger:
    """Merges one pair after the other. A core."""

    def __init__(self) -> None:
        self._finder = SeamFinder()

    def handle_pair(self, pair: StereoPair, into: I420, now_ns: int) -> None:
        """Write the merged picture of a pair into `into`. ConfigError as of `merge`."""
        left = None if pair.left is None else pair.left.data
        right = None if pair.right is None else pair.right.data
        # Of a stale camera its whole half stays in the picture, and is marked there.
        stale = pair.left_stale or pair.right_stale
        seam = self._finder.handle_pictures(left, None if stale else right)
        merge(left, right, into, seam)
        mark_halves(into, pair, now_ns)
