"""The robot's arm in three dimensions: where its links are when the tip is at (x, y)."""

from dataclasses import dataclass

import cv2
import numpy as np

from telepresence.world.brush import Brush, Yuv, ball, capsule, fill_mask, rod, yuv
from telepresence.world.geometry import Camera, Vector

SHOULDER_M = np.array((0.07, 0.46, 0.25))
LINK_M = 0.29
TIP_RADIUS_M = 0.0016
NECK_RADIUS_M = 0.0055
BODY_RADIUS_M = 0.0120
WRIST_RADIUS_M = 0.0190
FOREARM_RADIUS_M = 0.0210
UPPER_ARM_RADIUS_M = 0.0270
ELBOW_RADIUS_M = 0.0330

#: How far a shadow falls for each metre of height: the lamp hangs on the upper left.
SHADOW_M = np.array((0.34, -0.30))
SHADOW_LUMA = 26

_SHELL = yuv(206, 210, 214)
_JOINT = yuv(66, 74, 84)
_BAND = yuv(44, 98, 176)
_STEEL = yuv(150, 156, 162)
_GRIP = yuv(214, 96, 42)
_POINT = yuv(228, 228, 220)


@dataclass(frozen=True, slots=True)
class Arm:
    """(3,) points in metres, from the tip to the shoulder."""

    tip: Vector
    neck: Vector
    body: Vector
    wrist: Vector
    elbow: Vector
    shoulder: Vector


def pose(x_m: float, y_m: float) -> Arm:
    """The arm with the stylus upright on the board at (x, y), the elbow above and outside."""
    tip = np.array((x_m, y_m, 0.0))
    wrist = tip + np.array((0.0, 0.030, 0.190))
    to_shoulder = SHOULDER_M - wrist
    distance = float(np.linalg.norm(to_shoulder))
    axis = to_shoulder / distance
    outward = np.array((0.55, 0.0, 1.0))
    outward -= axis * float(outward @ axis)
    outward /= np.linalg.norm(outward)
    rise = float(np.sqrt(max(LINK_M**2 - (distance / 2) ** 2, 0.0)))
    elbow = wrist + to_shoulder / 2 + outward * rise
    return Arm(
        tip,
        tip + (wrist - tip) * 0.26,
        tip + (wrist - tip) * 0.88,
        wrist,
        elbow,
        SHOULDER_M,
    )


def draw_shadow(brush: Brush, camera: Camera, arm: Arm, offset: complex) -> None:
    """Darken the board where the tool keeps the light off; the arm is too high to cast one.

    offset: pixels, x + iy, added.
    """
    height, width = brush.y.shape
    casters = np.stack((arm.tip, arm.body, arm.wrist))
    ground = np.zeros((3, 3))
    ground[:, :2] = casters[:, :2] + SHADOW_M * casters[:, 2:]
    points, scales = camera.see(ground)
    points = points + offset
    radii = scales * _SHADOW_RADII_M
    outlines = np.stack(
        [capsule(points[k], points[k + 1], radii[k], radii[k + 1]) for k in range(2)]
    )
    left = max(int(outlines.real.min()) - 8, 0) & ~1
    top = max(int(outlines.imag.min()) - 8, 0) & ~1
    right = min(int(outlines.real.max()) + 9, width)
    bottom = min(int(outlines.imag.max()) + 9, height)
    if right <= left or bottom <= top:
        return
    # A shadow is soft, so a mask of half the size is enough, and four times as quick.
    mask = np.zeros(((bottom - top + 1) // 2, (right - left + 1) // 2), np.uint8)
    for outline in (outlines - complex(left, top)) * 0.5:
        fill_mask(mask, outline, SHADOW_LUMA)
    cv2.blur(mask, (5, 5), dst=mask)
    shadow = cv2.resize(mask, (right - left, bottom - top), interpolation=cv2.INTER_LINEAR)
    lit = brush.y[top:bottom, left:right]
    cv2.subtract(lit, shadow, dst=lit)


_SHADOW_RADII_M = np.array((0.003, BODY_RADIUS_M, WRIST_RADIUS_M))


def draw_arm(brush: Brush, camera: Camera, arm: Arm, offset: complex, *, from_above: bool) -> None:
    """Draw the arm, the farthest part first. offset: pixels, x + iy, added to every point.

    from_above: the camera hangs over the board, so the forearm is nearer to it than the tool.
    """
    elbow = camera.in_front(arm.wrist, arm.elbow)
    grip, forearm = arm.body - arm.neck, arm.elbow - arm.wrist
    seen, scale = camera.see(
        np.stack(
            (
                *(arm.tip, arm.neck, arm.body, arm.wrist, elbow, arm.shoulder),
                *(arm.neck + grip * 0.30, arm.neck + grip * 0.62),
                *(arm.wrist + forearm * 0.14, arm.wrist + forearm * 0.19),
            )
        )
    )
    at = (seen + offset).tolist()
    sizes = scale.tolist()

    def link(near: int, far: int, radii_m: tuple[float, float], colour: Yuv) -> None:
        radii = (radii_m[0] * sizes[near], radii_m[1] * sizes[far])
        rod(brush, at[near], at[far], radii, colour)

    def tool() -> None:
        link(_TIP, _NECK, (TIP_RADIUS_M, NECK_RADIUS_M), _POINT)
        link(_NECK, _BODY, (NECK_RADIUS_M * 1.3, BODY_RADIUS_M), _STEEL)
        link(_GRIP_LOW, _GRIP_HIGH, (BODY_RADIUS_M * 0.92, BODY_RADIUS_M * 1.02), _GRIP)

    def hand() -> None:
        ball(brush, at[_WRIST], WRIST_RADIUS_M * sizes[_WRIST], _JOINT)

    def arms() -> None:
        if not from_above:
            link(_ELBOW, _SHOULDER, (UPPER_ARM_RADIUS_M, UPPER_ARM_RADIUS_M), _SHELL)
            ball(brush, at[_ELBOW], ELBOW_RADIUS_M * sizes[_ELBOW], _JOINT)
        link(_WRIST, _ELBOW, (FOREARM_RADIUS_M * 0.85, FOREARM_RADIUS_M), _SHELL)
        link(_BAND_LOW, _BAND_HIGH, (FOREARM_RADIUS_M, FOREARM_RADIUS_M), _BAND)

    for part in (tool, hand, arms) if from_above else (arms, hand, tool):
        part()


_TIP, _NECK, _BODY, _WRIST, _ELBOW, _SHOULDER = range(6)
_GRIP_LOW, _GRIP_HIGH, _BAND_LOW, _BAND_HIGH = range(6, 10)
