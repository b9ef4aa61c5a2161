"""A partner in Chromium: it sees and hears us, and is seen and heard, by WebRTC."""

import json
import re
from collections import deque
from contextlib import contextmanager

import av
import numpy as np
from browser import eventually
from common import write_tone
from numbered_pictures import NumberedPictures, number_of, number_on, write_pictures
from programs import running
from running_session import COMMAND, RunningSession, restarted

OURS_HZ, THEIRS_HZ, SPACE_HZ = 700, 440, 1000
#: Longer than all that a test waits for: the server must not end by itself.
SECONDS = 900
#: A session that leaves the machine room for a browser.
ONE_CAMERA = """
cameras = ["static"]
uplink_video = { cap_kbps = 85, fps = 15 }
uplink_voice = { cap_kbps = 8 }
downlink_video = { cap_kbps = 512, fps = 15 }
downlink_voice = { cap_kbps = 64 }
"""
#: Makes what draws a programme's picture into a canvas, from which pixels can be read, and what
#: listens to its voice.
PROBE = """
const programme = arguments[0];
const video = document.querySelector(`video[data-programme=${programme}]`);
const canvas = document.createElement("canvas");
canvas.id = `probe-${programme}`;
document.body.append(canvas);
(window.drawn ??= {})[programme] = () => {
  canvas.width = video.videoWidth;
  canvas.height = video.videoHeight;
  canvas.getContext("2d", { willReadFrequently: true }).drawImage(video, 0, 0);
};
const sound = new AudioContext();
const ear = new AnalyserNode(sound, { fftSize: 8192 });
sound.createMediaStreamSource(video.srcObject).connect(ear);
const levels = new Float32Array(ear.frequencyBinCount);
(window.heardHz ??= {})[programme] = () => {
  ear.getFloatFrequencyData(levels);
  const best = levels.indexOf(Math.max(...levels));
  return levels[best] > -60 ? (best * sound.sampleRate) / ear.fftSize : 0;
};
"""


def loudest_hz(samples, rate_hz):
    levels = np.abs(np.fft.rfft(samples * np.hanning(len(samples))))
    return float(np.argmax(levels)) * rate_hz / len(samples)


@contextmanager
def serving(folder, *options):
    """`kontur-av rtc serve`; yields the address of its page. Its report is in report.json."""
    out, command = folder / "serve.txt", (*COMMAND, "rtc", "serve", "--http", "18930")
    words = ("--seconds", SECONDS, "--report", folder / "report.json", *options)
    with running(out, *command, *words):
        found = eventually(lambda: re.search(r"^page (\S+)\n", out.read_text(), re.M), "the page")
        yield found[1]


def test_a_browser_sees_hears_is_seen_and_is_heard(start_browser, tmp_path):
    write_pictures(tmp_path / "theirs.y4m", 150)
    write_tone(tmp_path / "theirs.wav", THEIRS_HZ)
    write_tone(tmp_path / "ours.wav", OURS_HZ)
    raw, voice = tmp_path / "raw.y4m", tmp_path / "voice.mka"
    seen = set()
    with (
        NumberedPictures(tmp_path / "ours") as ours,
        serving(
            tmp_path,
            *("--video", f"pipe:{ours.path}", "--fps", "15"),
            *("--audio", str(tmp_path / "ours.wav")),
            *("--raw", str(raw), "--save-voice", str(voice)),
        ) as url,
    ):
        browser = start_browser(camera=tmp_path / "theirs.y4m", microphone=tmp_path / "theirs.wav")
        page = browser.open(url)
        page.wait("document.querySelector('video').videoWidth > 0", "a picture")
        page.run(PROBE, "main")
        page.find("#send").click()

        def new_number():
            number = number_seen(page, "main")
            if number is not None:
                # What the browser shows was drawn, and in this order.
                assert max(seen, default=0) <= number <= ours.newest + 1
                seen.add(number)
            return len(seen) >= 5

        eventually(new_number, "five of our pictures in the browser")
        eventually(lambda: hears(page, "main", OURS_HZ), "our tone")
        page.wait("document.querySelector('#own-state').textContent === 'connected'")
        eventually(lambda: len(numbers_in(raw)) > 10, "ten of their pictures")
        page.screenshot(tmp_path / "page.png")
        browser.assert_no_errors()
        # The server ends the session at once when the page is left.
        page.close()
    with av.open(str(voice)) as file:
        (stream,) = file.streams.audio
        samples = np.concatenate([frame.to_ndarray()[0] for frame in file.decode(stream)])
        rate_hz = stream.rate
    # Not all of it: a busy machine has gaps, and at first the browser's gain control moves.
    parts = np.array_split(samples, len(samples) * 4 // rate_hz)
    assert any(abs(loudest_hz(part, rate_hz) - THEIRS_HZ) < 10 for part in parts)
    report = json.loads((tmp_path / "report.json").read_text())
    # The page connects anew after a stall.
    assert report["connections"] >= 2
    assert report["failed"] == []
    # Each picture that was decoded is in the file, to the last.
    assert report["pictures"]["decoded"] == len(list(pictures_of(raw)))


def number_seen(page, programme):
    """The number of the picture that a `<video>` shows; None in doubt."""
    page.run("drawn[arguments[0]]()", programme)
    return number_on(page, f"#probe-{programme}")


def hears(page, programme, hz):
    return abs(page.run("return heardHz[arguments[0]]()", programme) - hz) < 20


def test_a_partner_in_a_session_sees_and_hears_both_sides_and_is_shown_at_the_ground(
    start_browser, tmp_path, monkeypatch
):
    write_pictures(tmp_path / "theirs.y4m", 150, first=2001)
    for name, hz in (("theirs", THEIRS_HZ), ("ground", OURS_HZ), ("space", SPACE_HZ)):
        write_tone(tmp_path / f"{name}.wav", hz)
    with (
        NumberedPictures(tmp_path / "robot") as robot,
        NumberedPictures(tmp_path / "crew", before=1000) as crew,
        RunningSession(
            ONE_CAMERA,
            *("--rtc", "18940", "--page", "24200"),
            *("--source", f"static=pipe:{robot.path}"),
            *("--source", f"operator_camera=pipe:{crew.path}"),
            *("--source", f"ground_mic={tmp_path}/ground.wav"),
            *("--source", f"operator_mic={tmp_path}/space.wav"),
            directory=tmp_path,
        ) as session,
    ):
        session.wait_for_flow()
        browser = start_browser(camera=tmp_path / "theirs.y4m", microphone=tmp_path / "theirs.wav")
        (told,) = session.temporary.glob("*/*/rtc.json")
        page = browser.open(json.loads(told.read_text())["page"])
        page.find("#send").click()
        sides = {"uplink": (0, robot, OURS_HZ), "downlink": (1000, crew, SPACE_HZ)}
        for programme, (before, side, hz) in sides.items():
            page.wait(f"document.querySelector('[data-programme={programme}]').videoWidth > 0")
            page.run(PROBE, programme)

            def seen(programme=programme, before=before, side=side):
                number = number_seen(page, programme)
                return number is not None and before < number <= side.newest

            eventually(seen, f"a picture of the {programme}")
            eventually(
                lambda programme=programme, hz=hz: hears(page, programme, hz),
                f"the voice of the {programme}",
            )
        # The partner is on the ground's display, and on its page.
        with session.bus(monkeypatch) as bus:
            display = bus.reader("displayed/rtc_camera")
            eventually(lambda: (newest_number(display) or 0) > 2000, "the partner on the display")
            voice = Listener(bus.reader("received/rtc_voice", depth=16))
            eventually(lambda: voice.hears(THEIRS_HZ), "the partner's tone")
        ground = browser.open(session.pages()["ground"])
        eventually(lambda: (number_on(ground, "#partner") or 0) > 2000, "the partner's picture")
        ground.wait("document.querySelector('partner-panel').dataset.connected === 'true'")
        ground.wait("document.querySelector('partner-panel level-meter').ariaValueNow > -40")
        ground.screenshot(tmp_path / "ground.png")
        page.screenshot(tmp_path / "partner.png")
        browser.assert_no_errors()
        report = session.finish()
    assert all(shown["frames_displayed"] > 0 for shown in report["rtc"]["shown"].values())
    assert restarted(report) == {}


def newest_number(reader):
    """The number of the newest picture of a topic; None without one."""
    lease = reader.latest()
    if lease is None:
        return None
    with lease:
        frame = lease.video()
        return number_in(frame.data[: frame.height])


class Listener:
    """Hears the sound of a topic."""

    def __init__(self, reader):
        self._reader, self._blocks = reader, deque(maxlen=10)

    def hears(self, hz):
        """Whether this is the loudest frequency of the newest 200 ms."""
        while (lease := self._reader.next()) is not None:
            with lease:
                self._blocks.append(lease.audio().samples.copy())
        if len(self._blocks) < 10:
            return False
        return abs(loudest_hz(np.concatenate(self._blocks), 48_000) - hz) < 10


def numbers_in(path):
    """The numbers of the pictures in a YUV4MPEG2 file, which may still grow."""
    return {number for number in map(number_in, pictures_of(path)) if number is not None}


def pictures_of(path):
    """The luma of each whole picture of a YUV4MPEG2 file, shape (height, width)."""
    octets = path.read_bytes()
    header, begun, rest = octets.partition(b"\n")
    if not begun:
        return
    width, height = (int(re.search(rb" %c(\d+)" % letter, header)[1]) for letter in b"WH")
    size = len(b"FRAME\n") + width * height * 3 // 2
    for at in range(0, len(rest) - size + 1, size):
        luma = np.frombuffer(rest, np.uint8, width * height, at + len(b"FRAME\n"))
        yield luma.reshape(height, width)


def number_in(luma):
    """The number of a picture by its luma."""
    # As RGB of the narrow range, which `number_of` reads.
    grey = np.clip((luma.astype(np.float32) - 16) * 255 / 219, 0, 255).astype(np.uint8)
    return number_of(np.repeat(grey[:, :, None], 3, axis=2))
