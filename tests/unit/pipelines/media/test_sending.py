"""How a single stream is coded, as the options of `kontur-av send` say."""

import pytest

from kontur_av.clock import ManualClock
from kontur_av.errors import ConfigError
from pipelines.cli import make_parser
from pipelines.media import sending

WORDS = (
    *("send", "--video", "scene:static", "--to", "127.0.0.1:9"),
    *("--size", "160x120", "--cap-kbps", "100"),
)


def feed(*words):
    return sending.open_feed(make_parser().parse_args([*WORDS, *words]), ManualClock(0))


def test_refresh_and_search_reach_the_encoder_or_are_refused(monkeypatch):
    given = {}
    monkeypatch.setattr(sending, "PictureFeed", lambda *_, **options: given.update(options))
    for words, told in (
        ((), {"refresh_s": None, "search": "thorough"}),
        (("--refresh-s", "0.5"), {"refresh_s": 0.5}),
        (("--search", "quick"), {"search": "quick"}),
    ):
        feed(*words)
        assert told.items() <= given.items()
    for seconds in ("0.05", "601"):
        with pytest.raises(ConfigError, match="--refresh-s"):
            feed("--refresh-s", seconds)
