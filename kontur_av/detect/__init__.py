"""Detectors: when a light came on in pictures, and when a click began in sound.

Detectors do not know what to expect, nor where or when. Their input is what was really shown or
played, and the instants of that.
"""

from kontur_av.detect.click import Click, ClickDetector
from kontur_av.detect.light import Light, LightDetector, Roi

__all__ = ["Click", "ClickDetector", "Light", "LightDetector", "Roi"]
