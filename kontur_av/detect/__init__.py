"""Instants out of content: when a light came on in pictures, when a click began in sound.

Detectors are told nothing about what they are to find, nor where or when: they are fed with what
was really shown and heard, and the instants at which that was so.
"""

from kontur_av.detect.click import Click, ClickDetector
from kontur_av.detect.light import Light, LightDetector, Roi

__all__ = ["Click", "ClickDetector", "Light", "LightDetector", "Roi"]
