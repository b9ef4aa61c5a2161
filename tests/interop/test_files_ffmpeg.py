"""Media files of others: our sources show and sound what FFmpeg does, at the same instants."""

import json
import subprocess

import numpy as np
import pytest
from programs import needs

from kontur_av.clock import NS_PER_MS, NS_PER_S, ManualClock
from kontur_av.media import empty_picture
from kontur_av.sources import open_audio, open_video

pytestmark = pytest.mark.interop

SIZE = 64, 48
PICTURES = ["-f", "lavfi", "-i", "testsrc2=s=320x240:r=25:d=0.6"]
SOUND = ["-f", "lavfi", "-i", "sine=f=700:r=44100:d=1"]
X264 = ["-c:v", "libx264", "-preset", "ultrafast"]
BT2020 = "scale=out_color_matrix=bt2020:out_range=tv,format=yuv420p10le"
VIDEO = {
    "10bit.mkv": ["-pix_fmt", "yuv420p10le", "-c:v", "ffv1"],
    "2020.mkv": ["-vf", BT2020, "-c:v", "ffv1", "-colorspace", "bt2020nc"],
    "alpha.mov": ["-pix_fmt", "yuva444p10le", "-c:v", "prores_ks"],
    "grey.mkv": ["-pix_fmt", "gray16le", "-c:v", "ffv1"],
    "one_bit.nut": ["-pix_fmt", "monow", "-c:v", "rawvideo"],
    "palette.gif": [],
    "b_pictures.avi": ["-c:v", "mpeg4", "-bf", "2"],
    "fragments.mp4": [*X264, "-movflags", "frag_keyframe+empty_moov", "-g", "5"],
    "no_edit_list.mp4": [*X264, "-bf", "2", "-movflags", "negative_cts_offsets"],
    "wrap.ts": [*X264, "-output_ts_offset", "95442.9"],
    "444p12.y4m": ["-pix_fmt", "yuv444p12le", "-strict", "-1"],
}
TWO_TRACKS = ["-filter_complex", "asplit[a][b];[b]volume=0.2[c]", "-map", "[a]", "-map", "[c]"]
AUDIO = {
    "second.mkv": [*TWO_TRACKS, "-disposition:a:0", "0", "-disposition:a:1", "default"],
    "law.wav": ["-c:a", "pcm_mulaw"],
    "extensible.wav": ["-c:a", "pcm_s24le", "-ac", "2"],
    "surround.wav": ["-filter:a", "pan=5.1|FC=c0", "-c:a", "pcm_s16le"],
    "rf64.wav": ["-rf64", "always"],
    "lossless.flac": [],
}


def ffmpeg(*options):
    needs("ffmpeg")
    command = ["ffmpeg", "-v", "error", "-y", *options]
    return subprocess.run(command, capture_output=True, check=True, timeout=300).stdout


@pytest.mark.parametrize("name", VIDEO)
def test_pictures_are_those_of_ffmpeg(tmp_path, name):
    path = str(tmp_path / name)
    ffmpeg(*PICTURES, *VIDEO[name], path)
    fit = f"scale={SIZE[0]}:{SIZE[1]}:flags=bilinear:out_color_matrix=bt601:out_range=tv"
    raw = ffmpeg("-i", path, "-vf", f"{fit},format=yuv420p", "-f", "rawvideo", "-")
    wanted = np.frombuffer(raw, np.uint8).reshape(-1, SIZE[1] * 3 // 2, SIZE[0]).astype(int)
    probe = ["ffprobe", "-v", "quiet", "-show_entries", "frame=pts_time", "-of", "json", path]
    frames = json.loads(subprocess.check_output(probe, timeout=300))["frames"]
    clock, into, found = ManualClock(0), empty_picture(*SIZE), []
    source = open_video(path, name="v", width=SIZE[0], height=SIZE[1], fps=25, clock=clock)
    while len(found) < len(wanted):
        if (stamp := source.read(into, 20 * NS_PER_MS)) is not None:
            found.append((stamp.capture_ns / NS_PER_S, into.astype(int)))
    assert not source.faults
    assert (
        max(np.abs(want - shown).mean() for want, (_, shown) in zip(wanted, found, strict=True)) < 2
    )
    if all("pts_time" in frame for frame in frames):
        times_s = [float(frame["pts_time"]) for frame in frames]
        wanted_s = [time_s - times_s[0] for time_s in times_s]
        assert [at - found[0][0] for at, _ in found] == pytest.approx(wanted_s, abs=1e-3)


@pytest.mark.parametrize("name", AUDIO)
def test_sound_is_that_of_ffmpeg(tmp_path, name):
    path = str(tmp_path / name)
    ffmpeg(*SOUND, *AUDIO[name], path)
    raw = ffmpeg("-i", path, "-ac", "1", "-ar", "48000", "-f", "s16le", "-")
    wanted = np.frombuffer(raw, np.int16)[: 40 * 960].astype(int)
    source = open_audio(path, name="a", clock=ManualClock(0))
    blocks = []
    while len(blocks) < 40:
        if (block := source.read(NS_PER_S)) is not None:
            blocks.append(block.samples)
    assert not source.faults
    assert np.abs(np.concatenate(blocks)[9600:] - wanted[9600:]).max() < 100
