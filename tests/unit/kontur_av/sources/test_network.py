"""Which dates of a stream count, when it is tried again, and what is no address."""

import pytest

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ConfigError
from kontur_av.sources.network import SourceDates, pause_ns
from kontur_av.sources.spec import check_spec

NOW_NS = 100 * NS_PER_S


def test_the_first_date_decides_whether_those_of_a_connection_count():
    def ages(*stated_ms):
        dates = SourceDates()
        found = [dates.handle_date(NOW_NS - age * NS_PER_MS, NOW_NS) for age in stated_ms]
        return [None if at is None else (NOW_NS - at) // NS_PER_MS for at in found]

    assert ages(200, 3000) == [200, 3000]
    # A clock that was never set; one that is a bit ahead; one that is set in between.
    assert (ages(3000, 200), ages(-20)) == ([None, None], [0])
    assert ages(200, -3000, 200) == [200, None, None]


def test_a_refused_password_is_tried_rarely_and_all_else_soon_again():
    waits = [pause_ns(failures, refused=False) for failures in range(9)]
    assert waits == sorted(waits) and (waits[0], waits[-1]) == (NS_PER_S // 2, 5 * NS_PER_S)
    assert pause_ns(1, refused=True) == 60 * NS_PER_S


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
    with pytest.raises(ConfigError, match=words):
        check_spec(spec, "video")
