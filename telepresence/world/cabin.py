"""The camera in the station: a cosmonaut at the joystick, talking.

The module is drawn once, in RGB. The moving parts are drawn again: the clock's hands, a lamp, a
floating pen, the arm at the joystick, the head and the mouth.
"""

import math
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from kontur_av.clock import NS_PER_S
from kontur_av.media import I420, empty_picture
from telepresence.world.board import blend
from telepresence.world.brush import (
    Backdrop,
    Body,
    Brush,
    Caption,
    Points,
    Yuv,
    capsule,
    disc,
    finish,
    yuv,
)
from telepresence.world.sound import Speech
from telepresence.world.state import WorldState

Image = NDArray[np.uint8]

_SUIT = finish(yuv(52, 84, 140))
_SKIN = yuv(222, 176, 146)
_SKIN_BODY = finish(_SKIN)
_HAIR = yuv(84, 62, 46)
_STICK = finish(yuv(60, 64, 70), thin=True)
_KNOB = finish(yuv(196, 52, 40))
_PEN = finish(yuv(214, 182, 70))
_DARK = yuv(44, 34, 32)
_LIPS = yuv(168, 96, 88)
_WHITE = yuv(236, 234, 228)
_HEADSET_BODY = finish(yuv(46, 50, 56))
_HAND = yuv(200, 44, 36)
_LAMP_ON, _LAMP_OFF = yuv(110, 255, 120), yuv(28, 66, 34)

_CLOCK = complex(548, 92)
_CLOCK_RADIUS = 40.0
_LAMP = complex(608, 306)
_NECK = complex(300, 262)
_SHOULDER = complex(392, 330)
_JOYSTICK = complex(500, 452)


def _shaded(colour: Yuv, gain: float) -> Yuv:
    return round(16 + (colour[0] - 16) * gain), colour[1], colour[2]


_CIRCLE = np.exp(2j * np.pi * np.arange(24) / 24)
#: The ovals of the head: (x, y, half width, half height) relative to the face.
_FACE = (
    (0, -16, 61, 66),
    (0, 6, 55, 68),
    (-4, 3, 49, 63),
    (-14, -8, 28, 40),
    (0, -44, 52, 24),
    (-21, -20, 12, 3),
    (21, -20, 12, 3),
    (3, 9, 7, 12),
    (1, 7, 6, 11),
    (-21, -6, 10.5, 6.2),
    (21, -6, 10.5, 6.2),
)
#: Their colours, then those of the pupils and of the lids. A number changes the luma alone.
_FACE_COLOURS: tuple[Yuv | int, ...] = (
    *(_HAIR, _shaded(_SKIN, 0.80), _SKIN[0], _shaded(_SKIN, 1.06)[0]),
    *(_HAIR, _shaded(_HAIR, 0.8), _shaded(_HAIR, 0.8)),
    *(_shaded(_SKIN, 0.84)[0], _shaded(_SKIN, 1.03)[0]),
    *(_WHITE, _WHITE, _DARK, _DARK),
    *(_shaded(_SKIN, 0.9), _shaded(_SKIN, 0.9)),
)
_MOUTH_COLOURS = (_LIPS, _DARK)

#: Redraw interval of slow parts (head, pen, clock): at 8 px/s they move less than a pixel in it.
#: The mouth and the hand are drawn in every picture.
_SLOW_NS = NS_PER_S // 10


class CabinView:
    """The picture of the cabin in one size. `draw` writes a whole picture.

    speech: what the cosmonaut says, which moves the mouth.
    """

    def __init__(self, width: int, height: int, speech: Speech) -> None:
        self._speech = speech
        self._scale = min(width / 640, height / 480)
        self._origin = complex(width - 640 * self._scale, height - 480 * self._scale) / 2
        still = _draw_still(width, height, self._scale, self._origin)
        self._backdrop = Backdrop(still, 0, seed=11)
        self._caption = Caption("cabin", width, height)
        for copy in self._backdrop.copies:
            self._caption.paint(copy)
        self._slow = empty_picture(width, height)
        self._drawn: int | None = None
        self._place, self._tilt = _NECK, complex(1)

    def draw(self, state: WorldState, into: I420, frame: int) -> None:
        """Write the picture of `state` into `into`; `frame` is the number in its corner."""
        moment = state.time_ns // _SLOW_NS
        if moment != self._drawn:
            self._draw_slow(moment)
            self._drawn = moment
        np.copyto(into, self._slow)
        brush = Brush(into)
        self._mouth(brush, state.time_ns)
        self._arm(brush, state)
        self._caption.count(brush.y, frame)

    def _draw_slow(self, moment: int) -> None:
        self._backdrop.copy(self._slow, moment)
        brush, time_ns = Brush(self._slow), moment * _SLOW_NS
        self._clock_and_lamp(brush, time_ns)
        self._pen(brush, time_ns)
        self._head(brush, time_ns)

    def _at(self, place: complex) -> complex:
        return self._origin + place * self._scale

    def _bodies(self, brush: Brush, *bodies: Body) -> None:
        """Draw rods and balls, given in coordinates of a 640x480 picture."""
        s, at = self._scale, self._at
        brush.bodies([(at(a), at(b), r * s, q * s, finish) for a, b, r, q, finish in bodies])

    def _shapes(self, brush: Brush, outlines: Points, colours: Sequence[Yuv | int]) -> None:
        brush.shapes(np.asarray(self._origin + outlines * self._scale), colours)

    def _clock_and_lamp(self, brush: Brush, time_ns: int) -> None:
        seconds = time_ns // NS_PER_S
        hands = (
            _hand(seconds / 43_200, 0.5, 2.6),
            _hand(seconds / 3_600, 0.72, 2.0),
            # The second hand jumps, so that a viewer can count seconds in the picture.
            _hand(seconds % 60 / 60, 0.86, 1.2),
        )
        self._shapes(brush, np.array(hands), (_DARK, _DARK, _HAND))
        lit = (time_ns // (NS_PER_S // 2)) % 2 == 0
        self._shapes(brush, disc(_LAMP, 6.0)[None], (_LAMP_ON if lit else _LAMP_OFF,))

    def _pen(self, brush: Brush, time_ns: int) -> None:
        t = time_ns / NS_PER_S
        middle = complex(112 + 26 * math.sin(t / 3.1), 318 + 18 * math.sin(t / 2.3 + 1))
        axis = complex(math.cos(t / 4.7), math.sin(t / 4.7)) * 24
        self._bodies(brush, (middle - axis, middle + axis, 3.6, 3.0, _PEN))

    def _head(self, brush: Brush, time_ns: int) -> None:
        t = time_ns / NS_PER_S
        # The head sways slowly, nods slightly while it talks, and looks down at the hand.
        stress = sum(self._speech.loudness_at(time_ns - k * _SLOW_NS) for k in range(5)) / 5
        self._tilt = tilt = complex(math.cos(a := 0.05 * math.sin(t / 1.9)), math.sin(a))
        self._place = place = _NECK + complex(
            4 * math.sin(t / 2.7), 2 * math.sin(t / 1.3) + 3 * stress
        )
        glance = 2.5 + 2.0 * math.sin(t / 2.1)
        lids = ((-21, -6, 11, 6.8), (21, -6, 11, 6.8))
        blinking = time_ns % (4 * NS_PER_S) < 130_000_000
        self._bodies(brush, (_NECK + 8j, place - 40j, 24, 23, _SKIN_BODY))
        ovals = (
            *_FACE,
            *((-21 + glance, -5, 5, 5.4), (21 + glance, -5, 5, 5.4)),
            *(lids if blinking else ()),
        )
        self._shapes(brush, self._on_face(ovals), _FACE_COLOURS[: len(ovals)])
        ear, boom = (place + complex(x, y - 86) * tilt for x, y in ((-57, 4), (-22, 52)))
        self._bodies(
            brush, (ear + 10j * tilt, boom, 3, 3, _HEADSET_BODY), (ear, ear, 14, 14, _HEADSET_BODY)
        )

    def _on_face(self, ovals: Sequence[tuple[float, float, float, float]]) -> Points:
        """Return outlines of (x, y, half width, half height), which turn with the head."""
        across, down, half_width, half_height = np.array(ovals).T[..., None]
        shapes = half_width * _CIRCLE.real + 1j * (half_height * _CIRCLE.imag + down - 86) + across
        return np.asarray(shapes * self._tilt + self._place)

    def _mouth(self, brush: Brush, time_ns: int) -> None:
        loud = self._speech.loudness_at(time_ns)
        ovals = ((1, 40, 17, 4.5 + 8 * loud), (1, 40, 13, 1.2 + 7 * loud))
        self._shapes(brush, self._on_face(ovals), _MOUTH_COLOURS)

    def _arm(self, brush: Brush, state: WorldState) -> None:
        """Draw the right arm and the joystick, deflected like the stylus."""
        lean = complex(state.x_m / 0.15, -state.y_m / 0.10)
        knob = _JOYSTICK + complex(0, -56) + complex(lean.real * 26, lean.imag * 12)
        elbow = complex(438, 424) + lean.real * 8
        wrist = knob + complex(-3, 1)
        self._bodies(
            brush,
            (_JOYSTICK, knob, 7, 6, _STICK),
            (knob, knob, 15, 15, _KNOB),
            (_SHOULDER, elbow, 34, 27, _SUIT),
            (elbow, knob + complex(-16, 4), 26, 18, _SUIT),
            (wrist, wrist, 17, 17, _SKIN_BODY),
        )
        self._shapes(brush, _FINGERS + knob, _FINGER_COLOURS)


def _fingers() -> Points:
    """Return three fingers around a knob at 0, each a dark outline with a lit inner part."""
    begins = [complex(2, -9 + 8 * k) for k in range(3)]
    outlines = (
        capsule(begin, begin + (13 + 4j), *radii)
        for begin in begins
        for radii in ((5.5, 4.5), (4.3, 3.4))
    )
    return np.array(list(outlines))


_FINGERS = _fingers()
_FINGER_COLOURS = (_shaded(_SKIN, 0.7), _SKIN[0]) * 3


def _hand(turn: float, length: float, thickness: float) -> Points:
    """Return the outline of one of the clock's hands."""
    direction = complex(math.sin(2 * math.pi * turn), -math.cos(2 * math.pi * turn))
    end, side = _CLOCK + direction * _CLOCK_RADIUS * length, direction * 1j * thickness
    back = _CLOCK - direction * 5
    return np.array((back + side, back - side, end - side * 0.5, end + side * 0.5))


def _draw_still(width: int, height: int, scale: float, origin: complex) -> Image:
    """Draw the inside of the module as RGB: at twice the size, then scaled down."""
    zoom = 2 * scale
    image = np.zeros((height * 2, width * 2, 3), np.uint8)
    ys, xs = np.mgrid[0 : height * 2, 0 : width * 2].astype(np.float32)
    x, y = (xs / 2 - origin.real) / scale, (ys / 2 - origin.imag) / scale
    light = 0.62 + 0.38 * np.exp(-(((x - 300) / 330) ** 2) - ((y - 60) / 330) ** 2)
    for channel, level in enumerate((186, 190, 188)):
        image[..., channel] = light * np.float64(level)

    def at(px: float, py: float) -> tuple[int, int]:
        return round((px + origin.real / scale) * zoom), round((py + origin.imag / scale) * zoom)

    def size(length: float) -> int:
        return max(1, round(length * zoom))

    def box(left: float, top: float, right: float, bottom: float, *rgb: int) -> None:
        cv2.rectangle(image, at(left, top), at(right, bottom), rgb, cv2.FILLED)

    def line(ax: float, ay: float, bx: float, by: float, thick: float, *rgb: int) -> None:
        cv2.line(image, at(ax, ay), at(bx, by), rgb, size(thick), cv2.LINE_AA)

    def circle(cx: float, cy: float, radius: float, *rgb: int) -> None:
        cv2.circle(image, at(cx, cy), size(radius), rgb, cv2.FILLED, cv2.LINE_AA)

    # Racks with their seams, the ceiling light, blue handrails, cables, a net of bags.
    for column in range(-1, 6):
        line(column * 150 + 20, 0, column * 118 + 84, 480, 2.4, 122, 126, 126)
    for row in (150, 330):
        line(-400, row, 1040, row, 2.0, 126, 130, 130)
    box(180, 0, 430, 16, 250, 250, 240)
    for rail in (40, 436):
        line(rail, 178, rail + 80, 178, 7, 40, 84, 156)
        line(rail, 178, rail, 190, 7, 40, 84, 156)
        line(rail + 80, 178, rail + 80, 190, 7, 40, 84, 156)
    for k, rgb in enumerate(((60, 64, 70), (178, 112, 44), (196, 196, 190))):
        t = np.linspace(0, 1, 40)
        cable = [at(10 + 150 * a, 226 + 9 * k + 26 * math.sin(math.pi * a)) for a in t]
        cv2.polylines(image, [np.array(cable, np.int32)], False, rgb, size(3), cv2.LINE_AA)
    _window(image, at, size)
    # Clock.
    cx, cy = _CLOCK.real, _CLOCK.imag
    circle(cx, cy, _CLOCK_RADIUS + 6, 52, 56, 62)
    circle(cx, cy, _CLOCK_RADIUS + 1, 244, 244, 238)
    for tick in range(12):
        a = math.pi * tick / 6
        inner, outer = _CLOCK_RADIUS * (0.80 if tick % 3 else 0.70), _CLOCK_RADIUS * 0.92
        sa, ca = math.sin(a), math.cos(a)
        line(cx + sa * inner, cy - ca * inner, cx + sa * outer, cy - ca * outer, 2.2, 40, 40, 44)
    # A screen with a plot of the force, below the clock.
    box(476, 196, 628, 290, 34, 38, 44)
    box(483, 203, 621, 283, 18, 44, 60)
    plot = [at(486 + k * 2.2, 256 - 30 * math.exp(-(((k - 30) / 10) ** 2)) - 6 * math.sin(k / 5))
            for k in range(61)]  # fmt: skip
    for level in (223, 243, 263):
        line(486, level, 618, level, 0.6, 40, 86, 104)
    cv2.polylines(image, [np.array(plot, np.int32)], False, (96, 226, 180), size(2), cv2.LINE_AA)
    cv2.putText(image, "FORCE", at(487, 217), cv2.FONT_HERSHEY_SIMPLEX, 0.42 * zoom,
                (190, 220, 226), size(1), cv2.LINE_AA)  # fmt: skip
    box(560, 296, 628, 316, 44, 48, 54)
    for k, rgb in enumerate(((196, 60, 44), (214, 170, 52))):
        circle(572 + 18 * k, 306, 6, *rgb)
    # The cosmonaut's body and the shelf with the joystick.
    for thick, rgb in ((0, (34, 56, 98)), (7, (52, 84, 140))):
        cv2.ellipse(image, at(300, 500), (size(140 - thick), size(236 - thick)), 0, 180, 360, rgb,
                    cv2.FILLED, cv2.LINE_AA)  # fmt: skip
    line(300, 290, 300, 480, 2.4, 34, 54, 92)
    cv2.ellipse(
        image, at(300, 268), (size(42), size(17)), 0, 0, 360, (36, 58, 100), -1, cv2.LINE_AA
    )
    box(214, 356, 262, 386, 222, 226, 230)
    box(216, 358, 260, 371, 60, 104, 180)
    circle(350, 366, 17, 226, 228, 230)
    circle(350, 366, 14, 24, 44, 96)
    line(340, 372, 358, 358, 2.2, 232, 96, 60)
    box(418, 450, 1040, 800, 74, 80, 86)
    box(418, 446, 1040, 454, 120, 126, 132)
    circle(_JOYSTICK.real, _JOYSTICK.imag, 24, 34, 37, 42)
    small = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
    dither = np.random.default_rng(5).random((height, width, 1))
    return np.clip(small + dither, 0, 255).astype(np.uint8)


def _window(image: Image, at: object, size: object) -> None:
    """Draw a round window: the Earth's edge, a thin blue atmosphere, black space."""
    assert callable(at) and callable(size)
    centre, radius = at(100, 92), size(58)
    view = image.copy()
    cv2.circle(view, centre, radius, (4, 6, 12), cv2.FILLED)
    for shrink, rgb in ((0, (40, 92, 190)), (4, (104, 168, 236)), (8, (36, 92, 160))):
        cv2.circle(view, at(150, 282), size(190 - shrink), rgb, cv2.FILLED, cv2.LINE_AA)
    for x, y, a, b, turn in ((92, 118, 26, 5, 14), (120, 138, 22, 4, -10), (70, 136, 20, 4, 20)):
        axes = (size(a), size(b))
        cv2.ellipse(view, at(x, y), axes, turn, 0, 360, (206, 220, 230), cv2.FILLED, cv2.LINE_AA)
    mask = np.zeros(image.shape[:2], np.uint8)
    cv2.circle(mask, centre, radius, 255, cv2.FILLED, cv2.LINE_AA)
    cv2.circle(image, centre, size(70), (98, 102, 106), cv2.FILLED, cv2.LINE_AA)
    cv2.circle(image, centre, size(63), (54, 58, 62), cv2.FILLED, cv2.LINE_AA)
    blend(image, view, mask / 255.0)
    for k in range(12):
        angle = math.pi * k / 6 + 0.2
        bolt = at(100 + 66.5 * math.cos(angle), 92 + 66.5 * math.sin(angle))
        cv2.circle(image, bolt, size(2.2), (150, 154, 158), cv2.FILLED, cv2.LINE_AA)
