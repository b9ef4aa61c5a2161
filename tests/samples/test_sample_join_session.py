"""samples/join_session.py and `JoinedSession`: pictures, samples and telecommands of a session."""

import asyncio
import os
import re
import subprocess
import sys

import numpy as np
import pytest
from positions import ROOT
from running_session import RunningSession

from kontur_av.clock import MonotonicClock
from kontur_av.errors import ConfigError
from kontur_av.media import BLOCK_NS
from pipelines import JoinedSession

SAMPLE = ROOT / "samples" / "join_session.py"


def join(environment=None, *arguments):
    command = [sys.executable, str(SAMPLE), *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, env=environment)


def test_a_program_joins_a_session_until_it_ends(tmp_path, monkeypatch):
    with RunningSession("taskboard", directory=tmp_path) as session:
        session.wait_for_flow(["uplink_video"])
        done = join(session.environment, session.session, "static")
        assert done.returncode == 0, done.stderr
        pinged, selected, *rest = done.stdout.splitlines()
        for update in (selected, pinged):
            assert "ok=True" in update and "verified=True" in update
        for line in rest[:30]:
            assert re.fullmatch(r"\(480, 640, 3\), \d+ ms old, \w+", line), line
        assert len(rest) == 33
        monkeypatch.setenv("TMPDIR", str(session.temporary))
        code, report = asyncio.run(use(session))
        assert (code, report["failures"]) == (0, [])
        session.assert_nothing_left()


async def use(running):
    async with JoinedSession("taskboard") as session:
        with pytest.raises(ConfigError, match="unknown camera nowhere"):
            await session.aselect("nowhere")
        with pytest.raises(ConfigError, match="halt"):
            await session.acommand("joystick", "hlat")
        rows = []
        async for block in session.samples("joystick"):
            rows += block["time_ns"].tolist()
            if len(rows) == 200:
                break
        # Nothing of 1 kHz is left out in between.
        assert rows == sorted(set(rows)) and rows[-1] - rows[0] < 2 * 200 * 10**6
        with pytest.raises(ConfigError, match="no topic displayed/moon"):
            session.pictures("moon")
        pictures = session.pictures()
        ages = [(await anext(pictures)).age_ms]
        ending = asyncio.create_task(asyncio.to_thread(running.interrupt))
        ages += [picture.age_ms async for picture in pictures]
        assert all(0 < age < 60_000 for age in ages)
        assert pictures.ended == f"session {session.name} has ended"
        return await ending


def test_a_program_fills_an_input(tmp_path, monkeypatch):
    options = ("--source", "head=topic", "--source", "ground_mic=topic", "--no-page")
    with RunningSession("spacejustin", *options, directory=tmp_path) as running:
        running.wait_for_flow(["uplink_video"])
        monkeypatch.setenv("TMPDIR", str(running.temporary))
        clock = MonotonicClock()
        picture = np.zeros((480, 640, 3), np.uint8)
        picture[:, :, 0] = 200
        tone = (8000 * np.sin(np.arange(960) / 10)).astype(np.int16)
        with JoinedSession() as session:
            with pytest.raises(ConfigError, match="no topic page/moon"):
                session.input("moon")
            head, voice = session.input("head"), session.input("ground_mic")
            assert session.select("head").ok
            pictures, shown = session.pictures(), []
            for number in range(2000):
                voice.send(tone, clock.now_ns() - BLOCK_NS)
                if number % 2:
                    head.send(picture, clock.now_ns())
                clock.sleep_until_ns(clock.now_ns() + BLOCK_NS)
                if number % 50 == 49:
                    mean = next(pictures).data.mean(axis=(0, 1))
                    shown.append(mean)
                    if mean[0] > 150 and mean[1] < 60:
                        break
            else:
                pytest.fail(f"it was never shown: {shown}")
        code, report = running.interrupt()
    assert (code, report["failures"]) == (0, [])
    for name in ("head", "ground_mic"):
        (process,) = (
            one for key, one in report["processes"].items() if key in (name, f"camera_{name}")
        )
        assert process["counts"]["from_page"] > 20, process


def test_without_a_session_it_says_so_in_one_line(tmp_path):
    done = join({**os.environ, "TMPDIR": str(tmp_path)})
    assert done.returncode != 0
    assert done.stderr.splitlines()[-1].startswith(
        "kontur_av.errors.ConfigError: no session is run"
    )
