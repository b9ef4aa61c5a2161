"""What of a FIFO a reader gets that was late, and one whose writer hurries."""

import os

import pytest

from kontur_av.clock import NS_PER_MS, NS_PER_S, ManualClock
from kontur_av.media import empty_picture
from kontur_av.sources.pipe import PipeVideo

SIZE = 320, 240
PERIOD_NS = NS_PER_S // 10


@pytest.fixture
def ends(tmp_path):
    """A clock, the reading end and the file descriptor of the writing one."""
    os.mkfifo(tmp_path / "head")
    clock = ManualClock(NS_PER_S)
    source = PipeVideo("head", *SIZE, 30, clock, str(tmp_path / "head"))
    writer = os.open(tmp_path / "head", os.O_WRONLY)
    os.write(writer, b"YUV4MPEG2 W320 H240 F10:1\n")
    yield clock, source, writer
    os.close(writer)
    source.close()


def write(writer, *levels):
    for level in levels:
        os.write(writer, b"FRAME\n" + bytes([level]) * (320 * 240 * 3 // 2))


def read(source):
    picture = empty_picture(*SIZE)
    return int(picture[0, 0]) if source.read(picture, 10 * NS_PER_MS) else None


def test_a_reader_that_was_late_gets_the_newest_picture_and_is_late_no_more(ends):
    clock, source, writer = ends
    write(writer, 50)
    assert read(source) == 50
    clock.advance_ns(5 * PERIOD_NS)
    write(writer, 51, 52, 53, 54)
    assert (read(source), read(source)) == (54, None)
    clock.advance_ns(PERIOD_NS)
    write(writer, 55)
    assert read(source) == 55


def test_pictures_of_a_file_that_is_written_at_full_speed_all_come(ends):
    clock, source, writer = ends
    write(writer, *range(50, 58))
    begin_ns = clock.now_ns()
    assert [level for _ in range(60) if (level := read(source))] == list(range(50, 58))
    assert clock.now_ns() - begin_ns > 4 * PERIOD_NS
