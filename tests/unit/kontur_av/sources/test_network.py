"""Which dates of a stream count, and what is no address."""

import pytest

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ConfigError
from kontur_av.sources.network import SourceDates, pause_ns
from kontur_av.sources.spec import check_spec

NOW_NS = 100 * NS_PER_S


def judged(*ages_ms):
    dates = SourceDates()
    return [dates.handle_date(NOW_NS - age_ms * NS_PER_MS, NOW_NS) for age_ms in ages_ms]


def test_the_first_date_decides_whether_those_of_a_connection_count():
    assert judged(200, 3000) == [NOW_NS - 200 * NS_PER_MS, NOW_NS - 3000 * NS_PER_MS]
    # A clock that was never set; one that is a bit ahead; one that is set in between.
    assert judged(3000, 200) == [None, None]
    assert judged(-20) == [NOW_NS]
    assert judged(200, -3000, 200)[1:] == [None, None]


def test_a_refused_password_is_tried_rarely_and_all_else_soon_again():
    waits = [pause_ns(failures, refused=False) for failures in range(9)]
    assert waits == sorted(waits) and (waits[0], waits[-1]) == (NS_PER_S // 2, 5 * NS_PER_S)
    assert {pause_ns(failures, refused=True) for failures in range(9)} == {60 * NS_PER_S}


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ("rtsp://", "write rtsp://HOST:PORT/PATH"),
        ("rtsp://cam:99999/x", "write rtsp://HOST:PORT/PATH"),
        ("http://cam/a b", "without spaces"),
        ("udp://127.0.0.1", "write udp://HOST:PORT"),
        ("rtp:none.sdp", "no such file"),
        ("network:x", "write rtsp://"),
        ("rtsp://nobody.invalid/x", "no such host"),
    ],
)
def test_what_is_no_address_is_refused_with_the_fix(spec, words):
    with pytest.raises(ConfigError, match=words) as refused:
        check_spec(spec, "video")
    assert "\n" not in str(refused.value)
    with pytest.raises(ConfigError):
        check_spec(spec, "audio")
