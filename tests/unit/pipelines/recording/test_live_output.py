"""Where `receive --to` can hand a stream, and what it says of a URL that cannot work."""

import av
import pytest

from kontur_av.errors import ConfigError
from pipelines.recording import live_output
from pipelines.recording.live_output import LiveWriter

KINDS = r"write udp://HOST:PORT, .* or rtsp://HOST/NAME"


@pytest.mark.parametrize(
    ("url", "why"),
    [
        *((url, KINDS) for url in ("127.0.0.1:5004", "http://127.0.0.1:80", "udp://127.0.0.1")),
        *((url, KINDS) for url in ("udp://:5004", "udp://h:x")),
        ("udp://nobody.invalid:5004", "no host is known by the name"),
    ],
)
def test_a_url_that_no_player_has_is_refused_with_those_that_work(url, why):
    with pytest.raises(ConfigError, match=why):
        LiveWriter(url)


def test_srt_is_refused_with_the_way_round_where_ffmpeg_has_none(monkeypatch):
    def opened(*_args, **_options):
        raise av.error.ProtocolNotFoundError(1, "Protocol not found")

    monkeypatch.setattr(live_output.av, "open", opened)
    with pytest.raises(ConfigError, match="has no SRT; give --to udp://"):
        LiveWriter("srt://127.0.0.1:5004")
