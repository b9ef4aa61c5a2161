"""Senders of numpy pictures and sound: bad input is refused, and errors reach the caller."""

import time
from pathlib import Path

import numpy as np
import pytest
from av import VideoFrame

import kontur_av as av
from kontur_av.codecs.picture_formats import from_i420, to_i420
from kontur_av.streams.udp import UdpSender

GREY = np.full((96, 128, 3), 90, np.uint8)
HERE = "127.0.0.1:9"
CLIP = str(Path(__file__).parents[4] / "samples" / "clip.mp4")


def pictures(to=HERE, **options):
    return av.PictureSender(to, **{"cap_bps": 85_000} | options)


@pytest.mark.parametrize(
    "to",
    [
        *("127.0.0.1", "127.0.0.1:x", ":5004", "127.0.0.1:65535", "127.0.0.1:0"),
        *("no host.invalid:5004", "192.0.2.256:5004", "127.0.0.1:\u00b2", None, ("127.0.0.1", 9)),
    ],
)
def test_a_wrong_address_is_refused(to):
    for sender in (av.PictureSender, av.SoundSender):
        with pytest.raises(av.ConfigError, match=r"^to .*(HOST:PORT|no host is known)"):
            sender(to, cap_bps=85_000)
    # Any other port is taken, and an end that has sent nothing says so.
    for good in ("127.0.0.1:1", "[::1]:65534", "localhost:5004"):
        with pictures(good) as end:
            assert (end.counts.frames_captured, end.largest_bps) == (0, 0)
        end.close()


def test_what_is_no_picture_or_no_block_is_refused():
    with pictures() as end:
        for wrong in (GREY[:, :, 0], GREY.astype(np.float32), [[1]], None, "picture"):
            with pytest.raises(av.ConfigError, match="uint8, RGB"):
                end.send(wrong)
        for odd in (GREY[:95], GREY[:, :127], GREY[:14], VideoFrame(128, 95, "rgb24")):
            with pytest.raises(av.ConfigError, match="must be even"):
                end.send(odd)
        with pytest.raises(av.ConfigError, match="numpy cannot read"):
            end.send([[1], [2, 3]])
        end.focus(0.25, 0.25, 0.5, 0.5)
        end.send(GREY)
        assert str(end._feed.focus) == "0.25,0.25,0.5,0.5"
        with pytest.raises(av.ConfigError, match="128x64 after one of 128x96"):
            end.send(GREY[:64])
        with pytest.raises(av.ConfigError, match="four numbers"):
            end.focus("left", 0, 1, 1)
        now_ns = time.monotonic_ns()
        for wrong in (time.time_ns(), now_ns // 1000, 12.5, "now", end._stamped_ns):
            with pytest.raises(av.ConfigError, match="capture_ns "):
                end.send(GREY, capture_ns=wrong)
        end.send(picture=GREY, capture_ns=np.int64(now_ns))
    for another in (pictures(), end):
        another.close()
        with pytest.raises(av.ConfigError, match="closed"):
            another.send(GREY)
    with av.SoundSender(HERE, cap_bps=24_000) as end, pytest.raises(av.ConfigError, match="int16"):
        end.send(np.zeros(480, np.int16))


@pytest.mark.parametrize("height", [96, 98])
def test_each_form_of_a_picture_becomes_the_same(height):
    ramp = np.linspace(30, 220, 128).astype(np.uint8)
    rgb = np.repeat(np.stack([ramp, ramp[::-1], ramp // 2], 1)[None], height, 0)
    planar = to_i420(rgb, "rgb")
    assert planar.shape == (height * 3 // 2, 128)
    frame = VideoFrame.from_ndarray(rgb, "rgb24")
    for form, same in (("bgr", rgb[:, :, ::-1]), ("i420", planar), ("rgb", frame)):
        assert np.abs(to_i420(same, form).astype(int) - planar).max() <= 2, form
    assert np.abs(to_i420(rgb[:, :, 0], "grey")[:height, 0].astype(int) - 42).max() <= 1
    grey = rgb @ [0.299, 0.587, 0.114]
    for form, back in (("rgb", rgb), ("bgr", rgb[:, :, ::-1]), ("grey", grey)):
        assert np.abs(from_i420(planar, form) - back.astype(float)).mean() < 2, form


@pytest.mark.rule("6")
def test_what_cannot_work_is_refused_in_one_line(tmp_path):
    for options, reason in (
        *(({"fps": fps}, f"fps {fps!r}: ") for fps in (0, 121, float("nan"), "30", None)),
        *(({"cap_bps": cap}, "cap_bps ") for cap in ("250k", None, 0.5, float("inf"), 999, 2**40)),
        ({"codec": "hevc"}, "codec 'hevc'"),
        ({"format": "yuv"}, "format 'yuv'"),
        ({"cap_bps": 9_000}, "cap_bps of pictures"),
        ({"sdp": 5}, "sdp 5"),
        ({"sdp": tmp_path / "none" / "s.sdp"}, "cannot be written"),
    ):
        with pytest.raises(av.ConfigError, match=reason):
            pictures(**options)
    with pytest.raises(av.ConfigError, match="cannot be written"):
        av.SoundSender(HERE, cap_bps=24_000, sdp=tmp_path / "none" / "s.sdp")
    with pictures(cap_bps=np.float64(85e3), fps=np.float32(29.97)) as end:
        end.send(GREY)


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"source": "none.mp4"}, "none.mp4"),
        ({"to": "127.0.0.1"}, "HOST:PORT"),
        ({"cap_bps": "250k"}, "cap_bps '250k'"),
        ({"size": (641, 480)}, "641x480"),
        ({"size": 640}, "size 640: give"),
        ({"fps": 0}, "fps 0"),
        ({"codec": "vp8"}, "codec 'vp8'"),
        ({"search": "long"}, "search 'long'"),
        ({"refresh_s": "slow"}, "refresh_s 'slow'"),
        ({"seconds": "10 s"}, "seconds '10 s'"),
        ({"sdp": "none/s.sdp"}, "cannot be written"),
    ],
)
def test_send_refuses_what_cannot_work(options, reason):
    usual = {"source": CLIP, "to": HERE, "cap_bps": 85_000, "seconds": 0.1}
    with pytest.raises(av.ConfigError, match=reason):
        av.send(**usual | options)


def test_what_ends_the_thread_reaches_the_caller(monkeypatch):
    def fail(*_):
        raise RuntimeError("out of order")

    monkeypatch.setattr(UdpSender, "exchange", fail)
    with pytest.raises(RuntimeError, match="out of order"), pictures() as end:
        for _ in range(100):
            end.send(GREY)
