"""What an ALSA device cannot do is refused in one line."""

import re
import shutil
import subprocess

import pytest

from kontur_av.errors import ConfigError
from kontur_av.sources.microphone import check_microphone

FORMATS = "arecord: set_params:1352: Sample format non available\nAvailable formats:\n- S24_3LE"
RATE = """Recording raw data 'stdin' : Signed 16 bit Little Endian, Rate 48000 Hz, Mono
Warning: rate is not accurate (requested = 48000Hz, got = 44100Hz)
         please, try the plug plugin"""


@pytest.mark.parametrize(
    ("device", "told", "code", "words"),
    [
        ("hw:1", FORMATS, 1, "cannot be opened (Sample format non available): "),
        ("hw:1", RATE, 0, "records at 44100 Hz, not at 48000: "),
        ("hw:1,0", "arecord: main:831: audio open error: busy", 1, "(busy): "),
    ],
)
def test_what_a_device_lacks_is_named_with_the_mend(monkeypatch, device, told, code, words):
    def run(command, **_):
        return subprocess.CompletedProcess(command, code, None, told.encode())

    monkeypatch.setattr(shutil, "which", lambda name: f"/usr/bin/{name}")
    monkeypatch.setattr(subprocess, "run", run)
    fix = f"choose from `kontur-av devices`, or try alsa:plug{device}"
    with pytest.raises(ConfigError, match=f"{re.escape(words + fix)}$"):
        check_microphone(device)
