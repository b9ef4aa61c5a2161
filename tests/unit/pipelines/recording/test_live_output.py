"""Where `receive --to` can hand a stream, and what it says of a URL that cannot work."""

import av
import pytest

from kontur_av.errors import ConfigError
from pipelines.recording import live_output
from pipelines.recording.live_output import LiveWriter

KINDS = r"write udp://HOST:PORT, .* or rtsp://HOST/NAME"


def test_a_url_that_no_player_has_is_refused_with_those_that_work(monkeypatch):
    urls = ("127.0.0.1:5004", "http://127.0.0.1:80", "udp://127.0.0.1", "udp://:5004", "udp://h:x")
    unknown = {"udp://nobody.invalid:5004": "no host is known by the name"}
    for url, why in (dict.fromkeys(urls, KINDS) | unknown).items():
        with pytest.raises(ConfigError, match=why):
            LiveWriter(url)

    def opened(*_args, **_options):
        raise av.error.ProtocolNotFoundError(1, "Protocol not found")

    monkeypatch.setattr(live_output.av, "open", opened)
    with pytest.raises(ConfigError, match="has no SRT; give --to udp://"):
        LiveWriter("srt://127.0.0.1:5004")
