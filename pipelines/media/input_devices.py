"""The microphones (ALSA) of this machine."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class MicrophoneDevice:
    """An ALSA capture device. device: its name in alsa-lib, such as "plughw:0,0"."""

    device: str
    name: str


def microphones(asound: Path) -> Sequence[MicrophoneDevice]:
    """The capture devices that ALSA's /proc/asound/pcm lists.

    A line reads `00-02: ALC257 Analog : ALC257 Analog : playback 1 : capture 1`.
    """
    try:
        text = (asound / "pcm").read_text("utf-8", "replace")
    except OSError:
        return []
    found = []
    for line in text.splitlines():
        match = re.match(r"(\d+)-(\d+): ([^:]*)(?::.*)?: *capture \d+", line)
        if match:
            card, device = int(match[1]), int(match[2])
            # plughw converts to 48 kHz mono, which the bare hw device may not offer.
            found.append(MicrophoneDevice(f"plughw:{card},{device}", match[3].strip()))
    return found
