"""samples/slots_virtual_time.py runs and prints each flow."""

import subprocess
import sys

from places import ROOT

SAMPLE = ROOT / "samples" / "slots_virtual_time.py"


def test_sample_shows_each_flow():
    done = subprocess.run(
        [sys.executable, str(SAMPLE), "3"], capture_output=True, text=True, check=True
    )
    lines = done.stdout.splitlines()
    assert lines[0] == "haptic samples received: 3000 in 3000 slots"
    rows = {line.split()[0]: line.split() for line in lines[2:6]}
    assert set(rows) == {"video", "voice", "telecommands", "file"}
    assert float(rows["telecommands"][3]) <= 3
    assert float(rows["voice"][3]) <= 4
    assert float(rows["video"][2]) > 29
