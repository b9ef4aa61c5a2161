"""Behaviour of a new process: exit code, output, imports, and the choice of libopus."""

import os
import subprocess
import sys

import pytest

from kontur_av.codecs import libopus
from pipelines.commands.doctor import doctor
from pipelines.session import machine_checks


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


@pytest.mark.parametrize(
    ("commands", "absent"),
    [
        ("select record tc task authority trainer stop info", "aiortc av opuslib"),
        # They parse RTCP by a module of aiortc, without its ICE, DTLS and SCTP.
        ("stream send receive", "aiortc dns pylibsrtp"),
        # They must outlive broken software.
        (
            "apploader versions file keys authority stop",
            "aiortc av cv2 opuslib pipelines.session.setup.table",
        ),
    ],
)
def test_commands_at_a_running_session_and_of_upkeep_load_little(commands, absent):
    code = (
        "import sys\n"
        "from importlib import import_module\n"
        f"for name in {commands.split()}:\n"
        "    import_module(f'pipelines.commands.{name}')\n"
        f"assert not {{*{absent.split()}}} & sys.modules.keys()\n"
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
from pipelines.commands.doctor import doctor
from pipelines.session import machine_checks
from kontur_av.codecs.opus import OpusDecoder, OpusEncoder
encoder, decoder = OpusEncoder(bitrate_bps=8000), OpusDecoder()
packet = encoder.encode(np.zeros(960, np.int16))
assert len(packet) == 20 and decoder.decode(packet).shape == decoder.conceal().shape == (960,)
print(libopus.load().origin, libopus.load().version)
"""


@pytest.mark.parametrize(("found", "origin"), [("None", "PyAV"), ("find(name)", "system")])
def test_the_systems_libopus_comes_first_and_else_that_in_pyavs_wheel_is_used(found, origin):
    if origin == "PyAV" and libopus.carried_by_pyav("opus") is None:
        pytest.skip("libopus: this PyAV carries none")
    if origin == "system" and libopus.load().origin != "system":
        pytest.skip("libopus: apt-get install libopus0")
    code = ROUND_TRIP.format(found=found)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.stdout.startswith(f"{origin} libopus "), done.stderr
    assert done.stderr == ""


def test_the_doctor_says_that_a_machine_that_runs_the_tests_can_run_a_session():
    lines = []
    assert doctor(lines.append) == 0
    assert len(lines) == len(machine_checks.CHECKS) + 1
    assert all("\n" not in line for line in lines)
    assert lines[-1] == "a session can run"
    assert any("libx264" in line and line.startswith("ok") for line in lines)


def test_refused_real_time_names_the_limits_to_set(monkeypatch):
    monkeypatch.setattr(machine_checks, "_RT_PRIORITY", 1000)
    verdict = machine_checks.check_real_time()
    assert verdict.state == "advice"
    assert "rtprio 1000" in verdict.fix and "/etc/security/limits.d" in verdict.fix
