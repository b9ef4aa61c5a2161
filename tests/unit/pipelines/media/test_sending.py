"""How a stream is coded, as the options of `kontur-av send` say."""

from kontur_av.errors import ConfigError
from kontur_av.streams import sending
from pipelines.cli import main

WORDS = (
    *("send", "--video", "scene:static", "--to", "127.0.0.1:9"),
    *("--size", "160x120", "--cap-kbps", "100"),
)


def test_refresh_and_search_reach_the_encoder_or_are_refused(monkeypatch, capsys):
    given = {}

    def end(*_, **options):
        given.update(options)
        raise ConfigError("enough")

    monkeypatch.setattr(sending, "PictureFeed", end)
    for words, told in (
        ((), {"refresh_s": None, "search": "thorough", "coded_size": None, "cap_bps": 100_000}),
        (("--refresh-s", "0.5"), {"refresh_s": 0.5}),
        (("--search", "quick"), {"search": "quick"}),
    ):
        assert main([*WORDS, *words]) == 2
        assert "enough" in capsys.readouterr().err
        assert told.items() <= given.items()
