"""No spelling of an address shows its password."""

import string

import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from kontur_av.clock import ManualClock
from kontur_av.errors import ConfigError
from kontur_av.redaction import redacted, shown_spec
from kontur_av.sources import network
from kontur_av.sources.source import StampingSource
from kontur_av.sources.spec import check_spec
from pipelines.session.command_process import _SECRETS

SECRET = "S3cret"
NEAR = st.text("@:/?#[]%&=; \\'\"!,.~äx1" + string.whitespace, max_size=6)
SCHEMES = st.sampled_from(["rtsp", "RTSP", "rtspu", "rtsps", "http", "srt", "udp", "rtp", "rtmp"])
SLASHES = st.sampled_from(["://", ":/", ":", ":///", ":\\\\"])
AT = st.sampled_from(["@", "%40"])
QUERIES = ("?pwd=", "?user=a&pass=", "/user=a_password=", ";key=", "#", "?")


@st.composite
def addresses(draw):
    """An address with a password before its host, or behind it."""
    scheme, slashes = draw(SCHEMES), draw(SLASHES)
    # One slash may begin a path of any name, so only a well-known scheme makes an address then.
    assume(slashes in ("://", ":///", ":\\\\") or scheme not in ("udp", "rtmp"))
    password = draw(NEAR) + SECRET + draw(NEAR)
    if draw(st.booleans()):
        return f"{scheme}{slashes}bob:{password}{draw(AT)}cam/1"
    return f"{scheme}{slashes}cam:8554/1{draw(st.sampled_from(QUERIES))}{password}"


@given(addresses())
@example(f"rtsp://bob:a@{SECRET}?x@cam/1")
@example(f"http://cam/1?pwd=a@{SECRET}")
@example(f"rtsp://bob:{SECRET}%40cam/1")
def test_no_error_fault_or_list_of_processes_has_it(address):
    def refuse(_):
        raise OSError(f"no answer of {address}")

    before, network._Address.opened = network._Address.opened, refuse
    try:
        source = StampingSource("head", ManualClock(), address)
        source._fault("lost")
        shown = [
            shown_spec(address),
            shown_spec(f"head={address}"),
            source.last_fault,
            str(ConfigError(f"--source head={address!r}: no")),
        ]
        for kind in ("video", "audio"):
            with pytest.raises(ConfigError) as refused:
                check_spec(address, kind)
            shown.append(str(refused.value))
    finally:
        network._Address.opened = before
    octets = b"\0stream\0--source=head=" + address.encode() + b"\0"
    for found in _SECRETS.finditer(octets):
        first, last = found.span(found.lastindex)
        octets = octets[:first] + b"x" * (last - first) + octets[last:]
    assert SECRET not in repr(shown)
    assert SECRET.encode() not in octets


def test_host_and_path_stay_and_other_texts_are_as_they_were():
    assert shown_spec("rtsp://bob:pw@cam.lan:554/a/1") == "rtsp://cam.lan:554/a/1"
    assert redacted("'rtsp://bob:pw@[::1]:9/a': no; ask me") == "'rtsp://[::1]:9/a': no; ask me"
    assert redacted("at http://cam:8000/x: refused") == "at http://cam:8000/x: refused"
    for text in ("mcap:/a=b.mcap#/x", "head=clip@2x.mp4?"):
        assert redacted(text) == shown_spec(text) == text
