"""Picture quality: PSNR and SSIM of the luma. A core."""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

#: The PSNR of a picture without any error.
BEST_DB = 100.0

_WINDOW, _SIGMA = (11, 11), 1.5
_C1, _C2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2

Luma = NDArray[np.uint8]


def psnr_db(picture: Luma, original: Luma) -> float:
    """Peak signal-to-noise ratio in dB of two planes of one shape, uint8."""
    error = cv2.norm(picture, original, cv2.NORM_L2SQR) / picture.size
    return min(10 * math.log10(255**2 / error), BEST_DB) if error else BEST_DB


def ssim(picture: Luma, original: Luma) -> float:
    """Mean structural similarity, 1 for the same picture.

    Z. Wang et al., "Image quality assessment: from error visibility to structural similarity",
    IEEE Trans. Image Processing 13 (4), 2004: Gaussian window of 11 x 11, sigma 1.5. Only windows
    that lie wholly in the picture count.
    """
    a, b = picture.astype(np.float32), original.astype(np.float32)
    mean_a, mean_b = _blurred(a), _blurred(b)
    ab, aa, bb = mean_a * mean_b, mean_a * mean_a, mean_b * mean_b
    variances = _blurred(a * a) - aa + _blurred(b * b) - bb
    covariance = _blurred(a * b) - ab
    found = (2 * ab + _C1) * (2 * covariance + _C2) / ((aa + bb + _C1) * (variances + _C2))
    return float(found.mean())


def _blurred(plane: NDArray[np.float32]) -> NDArray[np.float32]:
    half = _WINDOW[0] // 2
    blurred: NDArray[np.float32] = np.asarray(cv2.GaussianBlur(plane, _WINDOW, _SIGMA))
    return blurred[half:-half, half:-half]


@dataclass(frozen=True, slots=True)
class QualityMeans:
    """The mean over all pictures, and the mean of the worst 5 % of them."""

    mean: float
    worst: float


def summarise(values: list[float]) -> QualityMeans:
    """NaN for no values at all."""
    if not values:
        return QualityMeans(math.nan, math.nan)
    ordered = sorted(values)
    worst = ordered[: max(round(len(ordered) / 20), 1)]
    return QualityMeans(float(np.mean(ordered)), float(np.mean(worst)))
