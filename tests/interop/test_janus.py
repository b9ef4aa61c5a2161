"""Many viewers are a media server's work: our picture goes to Janus once, and out to many."""

import asyncio
import json

import pytest
from janus_room import Audience
from programs import needs

pytestmark = pytest.mark.interop

VIEWERS = 8


def test_a_picture_that_goes_in_once_comes_out_to_many_viewers(tmp_path):
    needs("janus")

    async def watched():
        options = ["--video", "scene:static", "--size", "320x240", "--fps", "15"]
        async with Audience(tmp_path, *options, "--video-kbps", "200") as audience:
            await audience.add_viewers(VIEWERS)
            pictures = [viewer.pictures for viewer in audience.viewers]
            await audience.end_sender()
            return audience.door.offers, pictures, [one.decoded for one in audience.viewers]

    offers, pictures, decoded = asyncio.run(watched())
    assert [set(sizes) for sizes in decoded] == [{(320, 240)}] * VIEWERS
    report = json.loads((tmp_path / "publish.json").read_text())
    assert (offers, report["connections"]) == (1, 1)
    # The sender has coded and sent each picture once, whoever watched it.
    assert sum(pictures) > report["coded"]["video"]
