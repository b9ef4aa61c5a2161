"""Behaviour of a new process: exit code, output, imports, and the choice of libopus."""

import os
import subprocess
import sys

import pytest

from kontur_av.codecs import libopus


def test_the_installed_command_gives_the_same_message(tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "pipelines.cli", "stream", "--setup", "nosuch"],
        capture_output=True,
        text=True,
        timeout=60,
        env={**os.environ, "TMPDIR": str(tmp_path)},
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert len(done.stderr.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def test_later_output_follows_a_report_on_stdout(tmp_path):
    script = "from pathlib import Path; from pipelines.report.report_file import write_report\n"
    script += "write_report(Path('/dev/stdout'), {'a': 1}); print(7, flush=True)"
    with (tmp_path / "out").open("a") as out:
        subprocess.run([sys.executable, "-c", script], stdout=out, check=True)
    assert (tmp_path / "out").read_text().endswith("}\n7\n")


def test_commands_at_a_running_session_load_no_codec():
    code = (
        "import sys\n"
        "from importlib import import_module\n"
        "for name in 'select record tc task owner trainer stop info'.split():\n"
        "    import_module(f'pipelines.commands.{name}')\n"
        "assert not {'aiortc', 'av', 'opuslib'} & sys.modules.keys()\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


def test_commands_that_must_outlive_broken_software_load_little():
    code = (
        "import sys\n"
        "from importlib import import_module\n"
        "for name in 'apploader versions file keys owner stop'.split():\n"
        "    import_module(f'pipelines.commands.{name}')\n"
        "assert not {'aiortc', 'av', 'cv2', 'opuslib'} & sys.modules.keys()\n"
        "assert 'pipelines.session.setup.table' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


def test_sgp4_is_imported_for_a_pass_only():
    code = (
        "import sys\n"
        "from telepresence.link.radio import load_radio\n"
        "load_radio('geo').path('uplink', seed=1, epoch_ns=0)\n"
        "assert 'sgp4' not in sys.modules\n"
        "load_radio('iss-pass').path('uplink', seed=1, epoch_ns=0)\n"
        "assert 'sgp4' in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


ROUND_TRIP = """
import ctypes.util, warnings
warnings.simplefilter("error")
find = ctypes.util.find_library
ctypes.util.find_library = lambda name: {found} if name == "opus" else find(name)
import numpy as np
from kontur_av.codecs import libopus
from kontur_av.codecs.opus import OpusDecoder, OpusEncoder
encoder, decoder = OpusEncoder(bitrate_bps=8000), OpusDecoder()
packet = encoder.encode(np.zeros(960, np.int16))
assert len(packet) == 20 and decoder.decode(packet).shape == decoder.conceal().shape == (960,)
print(libopus.load().origin, libopus.load().version)
"""


def run(found):
    code = ROUND_TRIP.format(found=found)
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)


def test_the_libopus_in_pyavs_wheel_is_used_if_the_system_has_none():
    if libopus.carried_by_pyav() is None:
        pytest.skip("this PyAV carries no libopus")
    done = run("None")
    assert done.stdout.startswith("PyAV libopus "), done.stderr
    assert done.stderr == ""


def test_the_systems_libopus_comes_first():
    if libopus.load().origin != "system":
        pytest.skip("this system has no libopus")
    done = run("find(name)")
    assert done.stdout.startswith("system libopus "), done.stderr
    assert done.stderr == ""
