"""Which pictures of a camera become previews, and how large they are."""

import pytest

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.media import check_size
from pipelines.media.taking_over import Previewing, preview_size


@pytest.mark.parametrize(
    ("size", "small"),
    [
        ((640, 480), (160, 120)),
        ((384, 288), (160, 120)),
        ((1280, 720), (160, 88)),
        ((720, 1280), (66, 120)),
        ((64, 48), (64, 48)),
        ((4096, 16), (160, 16)),
    ],
)
def test_a_preview_has_the_aspect_of_its_picture(size, small):
    assert preview_size(*size) == small
    check_size(*small)


@pytest.mark.parametrize("fps", [10, 12, 25, 30])
def test_about_five_pictures_a_second_become_previews(fps):
    previewing, taken = Previewing(), []
    for number in range(4 * fps):
        now_ns = number * NS_PER_S // fps
        if previewing.due(now_ns):
            previewing.handle_preview(now_ns)
            taken.append(now_ns)
    assert len(taken) in (20, 21)


def test_whoever_begins_to_look_gets_the_next_picture_and_no_burst():
    previewing, taken = Previewing(), []
    previewing.handle_preview(0)
    for now_ms in range(10_010, 11_010, 40):
        if previewing.due(now_ms * NS_PER_MS):
            previewing.handle_preview(now_ms * NS_PER_MS)
            taken.append(now_ms)
    assert taken == [10_010, 10_210, 10_410, 10_610, 10_810]
