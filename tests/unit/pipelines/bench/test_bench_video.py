"""`kontur-av bench video`: marks, channel, figures and targets, without processes."""

from itertools import pairwise

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kontur_av.codecs.h264 import H264Decoder, H264Encoder
from kontur_av.media import CaptureStamp, VideoFrame, planes
from pipelines.bench.video.channel import ThinChannel, rtp_payload_octets
from pipelines.bench.video.clips import mirrored, scene
from pipelines.bench.video.figures import ContenderFigures, largest_bps, percentiles, shown
from pipelines.bench.video.marks import (
    NUMBERS,
    SQUARES,
    draw_number,
    levels,
    read_all,
    read_number,
)
from pipelines.bench.video.quality import BEST_DB, QualityMeans, psnr_db, ssim, summarise
from pipelines.bench.video.targets import DEFAULT, NARROW, OURS, TUNED, WIDE, judge
from pipelines.cli import main

MS, S = 1_000_000, 1_000_000_000
WIDTH, HEIGHT = 640, 480


def numbered(number: int) -> np.ndarray:
    picture = np.full((HEIGHT * 3 // 2, WIDTH), 90, np.uint8)
    draw_number(picture, number)
    return picture


def seen(number: int) -> np.ndarray:
    return levels(numbered(number)[:HEIGHT])


@given(st.integers(0, NUMBERS - 1))
def test_a_number_is_read_as_it_was_drawn(number):
    assert read_number(seen(number)) == number


@given(st.integers(0, NUMBERS - 2))
def test_from_one_number_to_the_next_two_squares_change(number):
    assert (seen(number) != seen(number + 1)).sum() == 2


@given(st.integers(0, NUMBERS - 1), st.integers(0, SQUARES - 1))
def test_a_wrong_or_grey_square_gives_no_number(number, square):
    squares = seen(number)
    squares[square] = 128
    assert read_number(squares) is None
    squares[square] = 255 - seen(number)[square]
    assert read_number(squares) is None


@pytest.mark.parametrize("coded", [(640, 480), (480, 360), (320, 240)])
def test_numbers_are_read_after_hard_compression_and_in_a_smaller_size(coded):
    clip = scene(WIDTH, HEIGHT, 30, 60)
    encoder = H264Encoder(width=coded[0], height=coded[1], fps=30, cap_bps=60_000)
    decoder = H264Decoder()
    read = []
    for number, original in enumerate(clip.pictures):
        picture = original.copy()
        draw_number(picture, number + 1000)
        small = np.empty((coded[1] * 3 // 2, coded[0]), np.uint8)
        for plane, target in zip(planes(picture), planes(small), strict=True):
            cv2.resize(plane, target.shape[::-1], dst=target, interpolation=cv2.INTER_AREA)
        unit = encoder.encode(VideoFrame(small, CaptureStamp(0, number, "test")))
        for decoded in decoder.decode(unit.data, number):
            luma = planes(decoded.to_i420())[0]
            full = cv2.resize(luma, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)
            read.append(read_number(levels(full)))
    # The first pictures get too few bits for the squares.
    assert read[5:] == list(range(1005, 1060))


def test_an_unreadable_picture_gets_the_number_between_its_neighbours():
    grey = np.full(SQUARES, 128, np.uint8)
    squares = [seen(3), grey, grey, seen(6), seen(7)]
    assert read_all(squares, [list(range(20))] * 5) == [3, 4, 5, 6, 7]


def test_a_half_coded_number_gets_the_best_fit():
    before, after = seen(40).astype(int), seen(44).astype(int)
    half = ((2 * before + 3 * after) // 5).astype(np.uint8)
    assert read_number(half) is None
    assert read_all([seen(40), half, seen(47)], [list(range(60))] * 3) == [40, 44, 47]


def test_numbers_not_yet_captured_or_left_out_are_impossible():
    grey = np.full(SQUARES, 128, np.uint8)
    captured = [[0, 1, 2], [0, 1, 2, 5], [0, 1, 2, 5, 9]]
    assert read_all([seen(2), grey, seen(9)], captured) == [2, 5, 9]
    assert read_all([seen(2), seen(7), seen(9)], captured) == [2, 5, 9]


def test_a_repeated_picture_gets_no_number():
    captured = [list(range(10))] * 4
    assert read_all([seen(4), seen(4), seen(5), seen(5)], captured)[:3] == [4, None, 5]


@given(
    st.lists(st.tuples(st.integers(0, 80 * MS), st.integers(1, 1500)), min_size=1, max_size=60),
    st.integers(10_000, 1_000_000),
)
def test_the_channel_keeps_order_and_rate_and_is_never_idle_with_a_queue(arrivals, rate_bps):
    channel = ThinChannel(rate_bps)
    now_ns, came, left = 0, [], []
    for number, (gap_ns, octets) in enumerate(arrivals):
        now_ns += gap_ns
        while (departure := channel.poll_transmit(now_ns)) is not None:
            left.append(departure)
        channel.handle_datagram(number.to_bytes(2, "big") + bytes(octets), number % 2, now_ns)
        came.append((now_ns, octets + 2))
    while (due_ns := channel.poll_timeout()) is not None:
        assert channel.poll_transmit(due_ns - 1) is None
        left.append(channel.poll_transmit(due_ns))
    assert [int.from_bytes(d.datagram[:2], "big") for d in left] == list(range(len(came)))
    assert [d.port for d in left] == [number % 2 for number in range(len(came))]
    free_ns = 0
    for (came_ns, octets), departure in zip(came, left, strict=True):
        takes_ns = octets * 8 * S / rate_bps
        begin_ns = max(free_ns, came_ns)
        assert begin_ns + takes_ns <= departure.due_ns < begin_ns + takes_ns + 1
        free_ns = departure.due_ns


def test_the_payload_is_counted_without_the_header():
    header = bytes([0x80, 96, *range(10)])
    assert rtp_payload_octets(header + bytes(50)) == 50
    contributors = bytes([0x82, *header[1:]]) + bytes(8)
    assert rtp_payload_octets(contributors + bytes(50)) == 50
    extension = bytes([0x90, *header[1:]]) + bytes([0, 0, 0, 2]) + bytes(8)
    assert rtp_payload_octets(extension + bytes(50)) == 50
    assert rtp_payload_octets(b"x") == 0


def test_a_clip_continues_backwards():
    assert mirrored(4, 9).tolist() == [0, 1, 2, 3, 2, 1, 0, 1, 2]
    assert mirrored(1, 3).tolist() == [0, 0, 0]


def test_pictures_of_the_settling_time_do_not_count():
    captured_ns = np.arange(1, 11) * 100 * MS
    shown_ns = {n: int(captured_ns[n]) + (30 + n) * MS for n in (0, 1, 2, 3, 5, 8, 9)}
    found = shown(captured_ns, shown_ns, first=2, fps=10)
    assert found.latency_ms == [32, 33, 35, 38, 39]
    assert found.per_second == pytest.approx(5 * 10 / 8)
    assert found.longest_gap_ms == pytest.approx(303)


def test_a_picture_that_never_comes_is_a_gap_to_the_end():
    captured_ns = np.arange(1, 11) * 100 * MS
    shown_ns = {n: int(captured_ns[n]) + 30 * MS for n in (0, 1, 2)}
    assert shown(captured_ns, shown_ns, first=2, fps=10).longest_gap_ms == pytest.approx(770)
    assert shown(captured_ns, {}, first=2, fps=10).longest_gap_ms == float("inf")


def test_percentiles_are_measured_values():
    assert percentiles(range(1, 101)) == {"p50": 50, "p95": 95, "p99": 99, "max": 100}
    assert percentiles([3.0]) == {"p50": 3, "p95": 3, "p99": 3, "max": 3}


def test_the_largest_windows_slide():
    came_ns = [0, 950 * MS, 1040 * MS, 1949 * MS]
    assert largest_bps(came_ns, [100, 200, 300, 400]) == (900 * 8, 500 * 80)


def test_quality_of_a_picture():
    one = np.random.default_rng(1).integers(0, 256, (120, 160), np.uint8)
    other = np.clip(one.astype(int) + 10, 0, 255).astype(np.uint8)
    difference = one.astype(float) - other
    assert psnr_db(one, other) == pytest.approx(10 * np.log10(255**2 / np.mean(difference**2)))
    assert psnr_db(one, one) == BEST_DB
    assert ssim(one, one) == pytest.approx(1)
    assert ssim(one, 255 - one) < 0 < ssim(one, other) < 1
    values = summarise([float(value) for value in range(40)])
    assert (values.mean, values.worst) == (19.5, 0.5)


def figures(**changes) -> ContenderFigures:
    base = {
        "latency_ms": {"p50": 30.0, "p95": 35.0, "p99": 40.0, "max": 50.0},
        "psnr_db": QualityMeans(30.0, 25.0),
        "ssim": QualityMeans(0.9, 0.8),
        "per_second": 29.0,
        "longest_gap_ms": 70.0,
        "payload_1s_bps": 85_000.0,
        "payload_100ms_bps": 120_000.0,
        "rtp_1s_bps": 88_000.0,
        "rtp_100ms_bps": 125_000.0,
        "rtcp_octets": 0,
        "answers": 0,
        "sender_cpu_s": 1.0,
        "receiver_cpu_s": 1.0,
        "guessed": 0,
        "unreadable": 0,
        "left_out_by_camera": 0,
        "camera_latest_us": 0.0,
        "channel_late_us": {"p50": 0.0, "p95": 0.0, "p99": 0.0, "max": 0.0},
        "channel_longest_wait_ms": 0.0,
        "realtime": True,
        "others_cores": 0.0,
    }
    return ContenderFigures(**(base | changes))


def missed(measured, targets=NARROW) -> list[str]:
    return [verdict.what for verdict in judge(measured, targets, 85) if not verdict.met]


def test_relative_targets_compare_with_the_better_peer():
    worse, better = QualityMeans(27.0, 23.9), QualityMeans(28.9, 20.0)
    peers = {DEFAULT: figures(psnr_db=worse), TUNED: figures(psnr_db=better, sender_cpu_s=0.4)}
    assert missed({OURS: figures(), **peers}) == []
    assert missed({OURS: figures(sender_cpu_s=1.2), **peers}) == [
        "CPU of both ends, of the thriftier peer's"
    ]
    assert len(missed({OURS: figures(psnr_db=QualityMeans(29.8, 24.8)), **peers})) == 2
    assert missed({OURS: figures(payload_1s_bps=85_001.0), **peers}) == [
        "largest 1 s window of payload"
    ]
    assert missed({OURS: figures(psnr_db=QualityMeans(28.8, 1.0)), **peers}, WIDE) == [
        "PSNR, over the tuned peer"
    ]


def test_without_a_peer_only_absolute_targets_are_judged():
    assert len(judge({OURS: figures()}, NARROW, 85)) == len(NARROW) - 3
    assert judge({TUNED: figures()}, NARROW, 85) == []


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--seconds", "0"], "--seconds 0"),
        (["--seconds", "9999"], "--seconds 9999"),
        (["--cap-kbps", "5"], "--cap-kbps 5"),
        (["--cap-kbps", "100"], "--channel-kbps 88"),
        (["--clip", "nowhere.mp4"], "nowhere.mp4"),
        (["--only", "nobody"], "--only nobody"),
        (["--size", "64x48"], "--size 64x48"),
        (["--report", "/nowhere/at/all.json"], "--report"),
        (["--plot", "latency.jpg"], "--plot"),
    ],
)
def test_mistakes_are_one_line(options, message, capsys):
    assert main(["bench", "video", *options]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def test_scenes_switch_cameras_every_five_seconds():
    clip = scene(320, 240, 1, 12)
    change = [float(np.abs(a.astype(int) - b).mean()) for a, b in pairwise(clip.pictures[:, :240])]
    assert sorted(np.argsort(change)[-2:].tolist()) == [4, 9]
