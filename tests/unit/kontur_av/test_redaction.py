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
BEFORE = st.sampled_from(["bob:", "cam/1?pwd=", "cam/1?a=b&c=", "cam/a_pass=", "cam;k=", "cam#"])
BEHIND = st.sampled_from(["@cam/1", "%40cam/1"])


@given(SCHEMES, SLASHES, BEFORE, NEAR, NEAR, BEHIND)
@example("rtsp", "://", "bob:", "a@", "?x", "@cam/1")
@example("http", "://", "cam/1?pwd=", "a@", "", "")
def test_no_error_fault_or_list_of_processes_has_it(scheme, slashes, before, one, other, behind):
    # One slash may begin a path of any name, so only a well-known scheme makes an address then.
    assume("://" in slashes or "\\" in slashes or scheme not in ("udp", "rtmp"))
    behind = behind if before == "bob:" else ""
    address = f"{scheme}{slashes}{before}{one}{SECRET}{other}{behind}"
    source = StampingSource("head", ManualClock(), address)
    source._fault("lost")
    shown = [shown_spec(address), shown_spec(f"head={address}"), source.last_fault]
    shown.append(str(ConfigError(f"--source head={address!r}: no")))
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(network._Address, "opened", lambda _: int(address))
        for kind in ("video", "audio"):
            with pytest.raises(ConfigError) as refused:
                check_spec(address, kind)
            shown.append(str(refused.value))
    assert SECRET not in repr(shown)
    octets = b"\0stream\0--source=head=" + address.encode() + b"\0"
    for found in _SECRETS.finditer(octets):
        octets = octets.replace(found[found.lastindex], b"")
    assert SECRET.encode() not in octets


def test_host_and_path_stay_and_other_texts_are_as_they_were():
    assert shown_spec("rtsp://bob:pw@cam.lan:554/a/1") == "rtsp://cam.lan:554/a/1"
    assert redacted("'rtsp://bob:pw@[::1]:9/a': no; ask me") == "'rtsp://[::1]:9/a': no; ask me"
    assert redacted("at http://cam:8000/x: refused") == "at http://cam:8000/x: refused"
    for text in ("mcap:/a=b.mcap#/x", "head=clip@2x.mp4?"):
        assert redacted(text) == shown_spec(text) == text
