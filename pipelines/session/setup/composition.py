"""Cameras whose picture is composed of two others': which ones, and where each is. A core."""

from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

from kontur_av.errors import ConfigError, one_of

#: `merged`: the left part of one beside the right part of the other, as one plane that both see.
#: `beside`: two whole pictures, each in half the width. `inset`: the second one in a corner.
Layout = Literal["merged", "beside", "inset"]
Corner = Literal["upper left", "upper right", "lower left", "lower right"]
#: The smallest inset each way, in pixels.
_LEAST = 16


class Area(NamedTuple):
    """A part of a picture in pixels, all even. x, y: its upper left corner."""

    x: int
    y: int
    width: int
    height: int


@dataclass(frozen=True, kw_only=True)
class Composition:
    """A camera that is composed of two inputs, `compose`, of which either may be missing or old.

    compose: the two inputs.
    layout: `merged`, as stereo is; `beside`, each in half the width; or `inset`, the second one in
        a corner.
    share: of an inset: its sides as a share of the picture's, 0.05 to 0.5.
    corner: of an inset: upper or lower, left or right.
    """

    compose: tuple[str, ...]
    layout: str = "beside"
    share: float = 0.3
    corner: str = "lower right"

    def areas(self, width: int, height: int) -> tuple[Area, Area]:
        """Where both pictures are in one of this even size."""
        middle, shown = width // 2 & ~1, height // 2 & ~1
        if self.layout == "merged":
            return Area(0, 0, middle, height), Area(middle, 0, width - middle, height)
        if self.layout == "beside":
            top = (height - shown) // 2 & ~1
            return Area(0, top, middle, shown), Area(middle, top, middle, shown)
        wide, high = round(width * self.share) & ~1, round(height * self.share) & ~1
        x = 0 if "left" in self.corner else width - wide
        y = 0 if "upper" in self.corner else height - high
        return Area(0, 0, width, height), Area(x, y, wide, high)

    def check(self, name: str, width: int, height: int) -> None:
        """ConfigError unless this can be the camera `name` in pictures of this size."""
        if len(set(self.compose)) != 2 or len(self.compose) != 2:
            raise ConfigError(f"composed.{name}: compose takes two cameras, such as head and wrist")
        one_of(self.layout, get_args(Layout), f"composed.{name}: layout")
        one_of(self.corner, get_args(Corner), f"composed.{name}: corner")
        if not 0.05 <= self.share <= 0.5:
            raise ConfigError(f"composed.{name}: share {self.share:g}: take 0.05 to 0.5")
        area = self.areas(width, height)[1]
        if min(area.width, area.height) < _LEAST:
            raise ConfigError(
                f"composed.{name}: a part of {area.width}x{area.height} pixels is too small: take "
                "a larger share, or a larger size of uplink_video"
            )


#: The camera that every setup can have, of the stereo pair.
STEREO = "stereo"
STEREO_PAIR = Composition(compose=("left", "right"), layout="merged")
