"""An input that a page takes over and that falls back to its own source, and its previews."""

from itertools import pairwise

import pytest
from rtp_packets import make_sender

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.media import BLOCK_NS, CaptureStamp, check_size
from pipelines.media.taking_over import Previewing, Takeover, preview_size

#: Milliseconds between two pictures.
PERIOD_MS = 40


class Input:
    """An input that is offered pictures or blocks; instants are in ms."""

    def __init__(self, takeover):
        self.takeover = takeover
        self.numbers = {True: 0, False: 0}
        #: What was taken: (of the page, capture in ms).
        self.taken = []
        self.stamps = []

    def own(self, capture_ms, now_ms=None):
        return self._offer(self.takeover.handle_own, False, capture_ms, now_ms, None)

    def page(self, capture_ms, now_ms=None, number=None):
        return self._offer(self.takeover.handle_page, True, capture_ms, now_ms, number)

    def _offer(self, handle, of_page, capture_ms, now_ms, number):
        number = self.numbers[of_page] if number is None else number
        self.numbers[of_page] = number + 1
        stamp = CaptureStamp(capture_ms * NS_PER_MS, number, "page_space" if of_page else "head")
        taken = handle(stamp, (capture_ms if now_ms is None else now_ms) * NS_PER_MS)
        if taken is not None:
            self.taken.append((of_page, taken.capture_ns // NS_PER_MS))
            self.stamps.append(taken)
        return taken


@pytest.fixture
def camera():
    return Input(Takeover.of_pictures("head"))


@pytest.fixture
def microphone():
    return Input(Takeover.of_sound("head"))


def test_without_a_page_nothing_changes_and_an_old_picture_takes_nothing_over(camera):
    given = [camera.own(at_ms) for at_ms in range(0, 400, PERIOD_MS)]
    assert [stamp.capture_ns // NS_PER_MS for stamp in given] == list(range(0, 400, PERIOD_MS))
    assert [stamp.sequence for stamp in given] == list(range(10))
    # A topic gives a new reader the sample before.
    camera.own(1000)
    assert camera.page(500, now_ms=1001) is None
    assert camera.takeover.live_source == "own"
    assert camera.own(1040) is not None


def test_a_page_takes_over_at_once_and_the_own_source_returns_half_a_second_after_it(camera):
    for at_ms in range(0, 2000, PERIOD_MS):
        camera.own(at_ms)
        if 400 <= at_ms < 1000:
            camera.page(at_ms - 5, now_ms=at_ms + 10)
    first, last = 435, 955
    assert [at_ms for of_page, at_ms in camera.taken if of_page] == [*range(first, last + 1, 40)]
    own = [at_ms for of_page, at_ms in camera.taken if not of_page]
    # Its last picture came at 970 ms.
    assert own == [*range(0, 401, 40), *range(1480, 2000, 40)]


def test_stamps_rise_and_count_without_a_gap_whatever_a_page_says(camera):
    camera.own(1000)
    for now_ms, capture_ms in ((1010, 2000), (1020, 900), (1030, 1030), (1040, 1030), (1050, 1045)):
        camera.page(capture_ms, now_ms=now_ms)
    camera.own(1560)
    page = [(True, at_ms) for at_ms in (1010, 1030, 1045)]
    assert camera.taken == [(False, 1000), *page, (False, 1560)]
    assert [stamp.sequence for stamp in camera.stamps] == list(range(5))
    assert {stamp.source for stamp in camera.stamps} == {"head"}
    assert (camera.takeover.from_page, camera.takeover.refused) == (3, 2)

    # The process knows when to look for its own source again.
    takeover = Takeover.of_pictures("head")
    assert takeover.poll_timeout() is None
    Input(takeover).page(1000, now_ms=1010)
    assert takeover.poll_timeout() == 1510 * NS_PER_MS
    assert takeover.live(1509 * NS_PER_MS) and not takeover.live(1510 * NS_PER_MS)
    assert takeover.poll_timeout() is None


def rtp_timestamps(stamps):
    """What the voice's sender makes of these blocks, in blocks since the first."""
    sender = make_sender(payload_type=97, clock_rate_hz=48_000, timestamp_offset=0)
    return [sender.audio_packets(b"opus", stamp).timestamp // 960 for stamp in stamps]


def test_sound_of_a_page_is_unbroken_though_its_stamps_jitter_and_a_gap_stays_one(microphone):
    for number, jitter_ms in enumerate((0, 8, -9, 5, -12, -30, 11, 0, 9, -7)):
        capture_ms = 1000 + 20 * number + jitter_ms
        microphone.page(capture_ms, now_ms=1040 + 20 * number)
    assert rtp_timestamps(microphone.stamps) == list(range(10))
    captures_ns = [stamp.capture_ns for stamp in microphone.stamps]
    assert captures_ns == sorted(set(captures_ns))
    broken = Input(Takeover.of_sound("head"))
    broken.page(1000, number=0)
    broken.page(1100, number=5)
    assert rtp_timestamps(broken.stamps) == [0, 5]


def test_no_sound_is_sent_twice_when_a_page_takes_over_or_goes(microphone):
    for at_ms in range(1000, 1100, 20):
        microphone.own(at_ms, now_ms=at_ms + 20)
    # The page is 60 ms behind: what it says of the time before is left out.
    for number in range(20):
        at_ms = 1105 + 20 * number
        microphone.page(at_ms - 60, now_ms=at_ms, number=700 + number)
    for at_ms in range(1400, 1900, 20):
        microphone.own(at_ms, now_ms=at_ms + 20)
    starts = [stamp.capture_ns for stamp in microphone.stamps]
    steps = [later - earlier for earlier, later in pairwise(starts)]
    assert min(steps) >= BLOCK_NS * 3 // 4
    # One silence, after the page: its last block came at 1485, and is missed for 200 ms.
    assert [step // NS_PER_MS for step in steps if step > 2 * BLOCK_NS] == [255]
    assert microphone.takeover.from_page == 17
    blocks = rtp_timestamps(microphone.stamps)
    assert blocks[-1] - blocks[0] == (starts[-1] - starts[0]) // BLOCK_NS


def previews(previewing, instants_ns):
    taken = []
    for now_ns in instants_ns:
        if previewing.due(now_ns):
            previewing.handle_preview(now_ns)
            taken.append(now_ns)
    return taken


def test_about_five_pictures_a_second_become_previews_with_their_aspect():
    for fps in (10, 12, 25, 30):
        instants_ns = [number * NS_PER_S // fps for number in range(4 * fps)]
        assert len(previews(Previewing(), instants_ns)) in (20, 21)
    # A reader that joins gets the next picture and no burst.
    previewing = Previewing()
    previewing.handle_preview(0)
    taken = previews(previewing, [ms * NS_PER_MS for ms in range(10_010, 11_010, 40)])
    assert taken == [ms * NS_PER_MS for ms in range(10_010, 10_811, 200)]
    for size, small in (
        *(((640, 480), (160, 120)), ((1280, 720), (160, 88)), ((720, 1280), (66, 120))),
        *(((64, 48), (64, 48)), ((4096, 16), (160, 16))),
    ):
        assert preview_size(*size) == small
        check_size(*small)
