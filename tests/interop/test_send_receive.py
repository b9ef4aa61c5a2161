"""`send` and `receive` with GStreamer and FFmpeg, over real sockets, with real codecs."""

import json
import re
import signal
from fractions import Fraction

import av
import numpy as np
import pytest
from common import psnr_db, write_tone
from media_commands import finish, ours, started, wait_for_file, wait_for_line
from programs import needs, needs_elements
from running_session import free_pair

from kontur_av.rtp.sdp import StreamDescription, write_sdp

pytestmark = pytest.mark.interop

WIDTH, HEIGHT, FPS = 320, 240, 30


def scene(number: int) -> np.ndarray:
    """Return a bright square that moves over a gradient: shape (360, 320), I420."""
    picture = np.full((HEIGHT * 3 // 2, WIDTH), 128, np.uint8)
    picture[:HEIGHT] = np.linspace(30, 150, WIDTH, dtype=np.uint8)
    left, top = 4 * (number % 60), 2 * (number % 60)
    picture[top : top + 60, left : left + 60] = 235
    return picture


def assert_is_the_film(path) -> None:
    """Assert that the raw file's pictures are those of the film, the last ones in order.

    A player that comes late has no key picture, and is healed by the waves of intra refresh within
    3 s. Pictures may be missing or repeated, because it follows the clock of a busy machine: one
    step may be of any length. Where the film begins anew, they are coarse for a while.
    """
    pictures = np.fromfile(path, np.uint8).reshape(-1, HEIGHT * 3 // 2, WIDTH)[-30:, :HEIGHT]
    film = [scene(number)[:HEIGHT] for number in range(60)]
    quality = np.array([[psnr_db(picture, one) for one in film] for picture in pictures])
    best, shown = quality.max(axis=1), quality.argmax(axis=1)
    assert np.median(np.sort(best)[-10:]) > 28, best
    steps = np.diff(shown[-10:]) % 60
    assert sorted(steps)[-2] < 30 and sum(steps) > 0, shown


@pytest.fixture(scope="module")
def film(tmp_path_factory):
    path = tmp_path_factory.mktemp("film") / "film.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=FPS, options={"crf": "8"})
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        for number in range(60):
            frame = av.VideoFrame.from_ndarray(scene(number), format="yuv420p")
            frame.pts, frame.time_base = number, Fraction(1, FPS)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


@pytest.fixture(scope="module")
def tone(tmp_path_factory):
    path = tmp_path_factory.mktemp("tone") / "tone.wav"
    write_tone(path, 440)
    return path


def play(tmp_path, sent, player):
    """Send, and let a program of others play it until it ends by itself; return what it wrote."""
    sdp, raw = tmp_path / "x.sdp", tmp_path / "x.raw"
    to = f"127.0.0.1:{free_pair()}"
    with ours("send", *sent, "--to", to, "--seconds", 60, "--sdp", sdp):
        wait_for_file(sdp)
        with started(*player.format(sdp=sdp, raw=raw).split()) as process:
            finish(process)
    return raw


def film_words(film, codec):
    size = ("--size", f"{WIDTH}x{HEIGHT}", "--fps", FPS)
    return ("--video", film, "--cap-kbps", 400, *size, "--codec", codec)


GST = "gst-launch-1.0 -q filesrc location={sdp} ! sdpdemux latency=50 ! "


def test_gstreamer_shows_the_h264_that_we_send(film, tmp_path):
    needs_elements("sdpdemux", "rtph264depay", "h264parse", "avdec_h264")
    player = GST + (
        "rtph264depay ! h264parse ! avdec_h264 ! videoconvert ! video/x-raw,format=I420 ! "
        "identity eos-after=150 ! filesink location={raw}"
    )
    assert_is_the_film(play(tmp_path, film_words(film, "h264"), player))


def test_ffmpeg_shows_the_h265_that_we_send(film, tmp_path):
    needs("ffmpeg")
    player = (
        "ffmpeg -v error -protocol_whitelist file,udp,rtp -i {sdp} -frames:v 150 "
        "-f rawvideo -pix_fmt yuv420p {raw}"
    )
    assert_is_the_film(play(tmp_path, film_words(film, "h265"), player))


def test_gstreamer_plays_the_voice_we_send(tone, tmp_path):
    needs_elements("sdpdemux", "rtpopusdepay", "opusdec")
    player = GST + (
        "rtpopusdepay ! opusdec ! audioconvert ! audio/x-raw,format=S16LE,rate=48000,channels=1 ! "
        "identity eos-after=60 ! filesink location={raw}"
    )
    raw = play(tmp_path, ("--audio", tone, "--cap-kbps", 64), player)
    sound = np.fromfile(raw, "<i2")[-48_000:].astype(float)
    loudest = np.argmax(np.abs(np.fft.rfft(sound * np.hanning(sound.size))))
    assert loudest * 48_000 / sound.size == pytest.approx(440, abs=3)


def receive(tmp_path, port, kind, **description):
    """Start `receive` on a stream; return its process and the path of its report."""
    sdp, report = tmp_path / "r.sdp", tmp_path / "r.json"
    stream = StreamDescription(
        kind=kind, host="127.0.0.1", port=port, payload_type=96, **description
    )
    sdp.write_text(write_sdp(stream))
    return ours("receive", "--sdp", sdp, "--report", report, "--save", tmp_path / "r.mkv"), report


@pytest.mark.parametrize(("codec", "aggregate"), [("h264", "none"), ("h265", "zero-latency")])
def test_we_play_what_gstreamer_sends(tmp_path, codec, aggregate):
    needs_elements(f"x{codec[1:]}enc", f"rtp{codec}pay", "rtpbin")
    port = free_pair()
    process, report_file = receive(tmp_path, port, "video", codec=codec)
    # rtpbin sends reports, so the latency is known.
    pipeline = (
        "rtpbin name=r videotestsrc is-live=true num-buffers=60 pattern=ball ! "
        f"video/x-raw,width={WIDTH},height={HEIGHT},framerate={FPS}/1 ! "
        f"x{codec[1:]}enc tune=zerolatency bitrate=300 key-int-max=30 ! "
        f"rtp{codec}pay pt=96 aggregate-mode={aggregate} ! r.send_rtp_sink_0 "
        f"r.send_rtp_src_0 ! udpsink host=127.0.0.1 port={port} "
        f"r.send_rtcp_src_0 ! udpsink host=127.0.0.1 port={port + 1} sync=false async=false"
    )
    with process as receiver:
        wait_for_line(receiver, "waiting")
        # About one pipeline with rtpbin in ten hangs after everything was sent, so it is killed.
        with started("gst-launch-1.0", "-q", *pipeline.split()):
            finish(receiver)
    report = json.loads(report_file.read_text())
    assert report["frames_decoded"] >= 59
    assert (report["rtp_lost"], report["frames_damaged"], report["frames_corrupt"]) == (0, 0, 0)
    assert report["size"] == [WIDTH, HEIGHT]
    assert report["rtcp_reports"] >= 1
    with av.open(str(tmp_path / "r.mkv")) as saved:
        assert sum(1 for _ in saved.decode(video=0)) == report["frames_decoded"]


def test_we_play_the_opus_that_gstreamer_sends(tmp_path):
    needs_elements("opusenc", "rtpopuspay")
    port = free_pair()
    process, report_file = receive(tmp_path, port, "audio")
    pipeline = (
        "audiotestsrc is-live=true num-buffers=100 samplesperbuffer=960 ! "
        "audio/x-raw,rate=48000,channels=1 ! opusenc bitrate=32000 ! rtpopuspay pt=96 ! "
        f"udpsink host=127.0.0.1 port={port}"
    )
    with process as receiver:
        wait_for_line(receiver, "waiting")
        with started("gst-launch-1.0", "-q", *pipeline.split()) as player:
            finish(player)
        finish(receiver)
    report = json.loads(report_file.read_text())
    assert report["rtp_lost"] == 0
    # Sound that is too late to be heard, because the machine stalled, is left out.
    left_out = report["frames_late"] + report["frames_left_out"]
    assert report["frames_decoded"] + left_out >= 99
    with av.open(str(tmp_path / "r.mkv")) as saved:
        heard = sum(frame.samples for frame in saved.decode(audio=0))
        assert heard >= 0.9 * report["frames_decoded"] * 960 > 0


def test_we_play_what_ffmpeg_sends_by_its_own_sdp(tmp_path):
    needs("ffmpeg")
    port, sdp, report_file = free_pair(), tmp_path / "f.sdp", tmp_path / "f.json"
    # With a global header, SPS and PPS are only in the SDP.
    with started(
        *("ffmpeg", "-v", "error", "-re", "-f", "lavfi"),
        *("-i", f"testsrc=size={WIDTH}x{HEIGHT}:rate={FPS}", "-t", 600, "-pix_fmt", "yuv420p"),
        *("-c:v", "libx264", "-tune", "zerolatency", "-g", 15, "-flags", "+global_header"),
        *("-f", "rtp", "-sdp_file", sdp, f"rtp://127.0.0.1:{port}"),
    ) as player:
        wait_for_file(sdp)
        with ours("receive", "--sdp", sdp, "--report", report_file) as receiver:
            lines = (line for line in receiver.stdout if "decoded" in line)
            next(line for line in lines if int(re.search(r"(\d+) decoded", line)[1]) >= 45)
            # It says goodbye.
            player.send_signal(signal.SIGINT)
            finish(receiver)
    report = json.loads(report_file.read_text())
    assert report["frames_decoded"] >= 45
    assert (report["rtp_lost"], report["frames_corrupt"]) == (0, 0)
