"""A microphone whose recording program writes many messages."""

import pytest

from kontur_av.clock import NS_PER_MS, NS_PER_S, ManualClock, MonotonicClock
from kontur_av.sources.microphone import MicrophoneAudio

CLOCK = MonotonicClock()
#: More than the 64 KiB that a pipe holds, before the sound, and a last message after it.
TALKATIVE = """#!/bin/sh
case "$*" in *" -s 1") exit 0;; esac
head -c 200000 /dev/zero | tr '\\0' x >&2
echo >&2
head -c 19200 /dev/zero
echo "arecord: pcm_read:2221: read error: No such device" >&2
"""


@pytest.fixture
def recorder(tmp_path, monkeypatch):
    def install(script):
        program = tmp_path / "arecord"
        program.write_text(script)
        program.chmod(0o755)
        monkeypatch.setattr("shutil.which", lambda name: str(program))

    return install


def test_messages_of_the_recorder_never_stop_the_sound(recorder):
    recorder(TALKATIVE)
    source = MicrophoneAudio("default", name="ground_mic", clock=CLOCK)
    blocks = []
    for _ in range(200):
        block = source.read(50 * NS_PER_MS)
        if block is not None:
            blocks.append(block)
        if source.faults:
            break
    source.close()
    assert blocks
    assert source.last_fault == "default: No such device"


def test_a_device_without_a_clock_is_held_to_real_time(recorder):
    recorder("#!/bin/sh\nexec head -c 40000000 /dev/zero\n")
    clock = ManualClock(0)
    source = MicrophoneAudio("null", name="ground_mic", clock=clock)
    heard = sum(source.read(NS_PER_S) is not None for _ in range(200))
    source.close()
    assert heard == 200
    assert clock.now_ns() > 3.8 * NS_PER_S
