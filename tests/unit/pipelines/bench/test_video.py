"""`kontur-av bench video`: marks, channel, figures and targets, without processes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipelines.bench.course import marks
from pipelines.bench.course.ends import ThinChannel, muxed_payload_octets, rtp_payload_octets
from pipelines.bench.video.clips import film
from pipelines.bench.video.quality import largest_bps, latest, mean_bps, percentiles, shown

MS, S = 1_000_000, 1_000_000_000
WIDTH, HEIGHT = 640, 480


def numbered(number: int) -> np.ndarray:
    picture = np.full((HEIGHT * 3 // 2, WIDTH), 90, np.uint8)
    marks.draw_number(picture, number)
    return picture


def seen(number: int) -> np.ndarray:
    return marks.levels(numbered(number)[:HEIGHT])


@given(st.integers(0, marks.NUMBERS - 2), st.integers(0, marks.SQUARES - 1))
def test_a_number_is_read_as_it_was_drawn_or_not_at_all(number, square):
    squares = seen(number)
    assert marks.read_number(squares) == number
    assert (squares != seen(number + 1)).sum() == 2, "from one number to the next"
    for wrong in (128, 255 - squares[square]):
        spoilt = squares.copy()
        spoilt[square] = wrong
        assert marks.read_number(spoilt) is None


@pytest.mark.parametrize(
    ("squares", "captured", "found"),
    [
        # An unreadable picture gets the number between its neighbours, a repeated one none.
        ((3, None, None, 6, 7), [range(20)] * 5, [3, 4, 5, 6, 7]),
        ((4, 4, 5, 5), [range(10)] * 4, [4, None, 5, None]),
        # Numbers not yet captured or left out are impossible.
        ((2, None, 9), [[0, 1, 2], [0, 1, 2, 5], [0, 1, 2, 5, 9]], [2, 5, 9]),
        ((2, 7, 9), [[0, 1, 2], [0, 1, 2, 5], [0, 1, 2, 5, 9]], [2, 5, 9]),
    ],
)
def test_numbers_of_pictures_follow_from_those_that_can_be_read(squares, captured, found):
    grey = np.full(marks.SQUARES, 128, np.uint8)
    drawn = [grey if number is None else seen(number) for number in squares]
    read = marks.read_all(drawn, [list(one) for one in captured])
    assert read[:3] == found[:3] and len(read) == len(found)


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


def test_payload_rates_percentiles_and_the_pictures_that_count():
    header = bytes([0x80, 96, *range(10)])
    contributors = bytes([0x82, *header[1:]]) + bytes(8)
    extension = bytes([0x90, *header[1:]]) + bytes([0, 0, 0, 2]) + bytes(8)
    for one in (header, contributors, extension):
        assert rtp_payload_octets(one + bytes(50)) == 50
    assert rtp_payload_octets(b"x") == 0
    # On a shared port only media packets have payload.
    media = bytes([0x90, 0xE0, *range(10), 0xBE, 0xDE, 0, 1]) + bytes(4 + 50 + 10)
    assert muxed_payload_octets(media) == 50
    # Sender and receiver reports, STUN, and DTLS.
    for first, second in ((0x80, 200), (0x81, 201), (0, 1), (22, 0xFE)):
        assert muxed_payload_octets(bytes([first, second]) + bytes(60)) is None
    # The largest windows slide.
    came_ns = [0, 950 * MS, 1040 * MS, 1949 * MS]
    assert largest_bps(came_ns, [100, 200, 300, 400]) == (900 * 8, 500 * 80)
    came_ns = [0, S // 2, S, 2 * S, 3 * S]
    assert mean_bps(came_ns, [100, 200, 300, 400, 500], begin_ns=S // 2, seconds=2) == 4 * 900
    assert percentiles(range(1, 101)) == {"p50": 50, "p95": 95, "p99": 99, "max": 100}
    assert latest([1, None, 3, 6], 5) == (2, 3)
    assert latest([None, 3], 2) == (-1, None)
    captured_ns = np.arange(1, 11) * 100 * MS
    shown_ns = {n: int(captured_ns[n]) + (30 + n) * MS for n in (0, 1, 2, 3, 5, 8, 9)}
    found = shown(captured_ns, shown_ns, first=2, fps=10)
    assert found.latency_ms == [32, 33, 35, 38, 39]
    assert found.per_second == pytest.approx(5 * 10 / 8)
    assert found.longest_gap_ms == pytest.approx(303)
    early = {n: int(captured_ns[n]) + 30 * MS for n in (0, 1, 2)}
    assert shown(captured_ns, early, first=2, fps=10).longest_gap_ms == pytest.approx(770)
    assert shown(captured_ns, {}, first=2, fps=10).longest_gap_ms == float("inf")


def test_numbered_pictures_in_one_file_become_a_clip_pixel_by_pixel(tmp_path):
    random = np.random.default_rng(1)
    pictures = random.integers(0, 256, (3, 52, 68), np.uint8)
    path = tmp_path / "three.pgm"
    path.write_bytes(b"".join(b"P5 68 52 255\n" + picture.tobytes() for picture in pictures))
    clip = film(path, "three", 64, 48, 5)
    assert clip.order.tolist() == [0, 1, 2, 1, 0]
    assert not clip.tuned_on
    # A picture file has black at 0 and white at 255, video at 16 and 235.
    expected = 16 + pictures[:, 2:50, 2:66] * (219 / 255)
    assert np.abs(clip.pictures[:, :48] - expected).max() <= 1
