"""Many viewers are a media server's work: our picture goes to Janus once, and out to many."""

import asyncio
import json
import time

import pytest
from common import TIMEOUT_S
from janus_room import Audience
from programs import needs

pytestmark = pytest.mark.interop

VIEWERS, FPS = 8, 15


async def test_a_picture_that_goes_in_once_comes_out_to_many_viewers(tmp_path):
    needs("janus")
    began_s = time.monotonic()
    options = ["--video", "scene:static", "--size", "320x240", "--fps", str(FPS)]
    async with Audience(tmp_path, *options, "--video-kbps", "200") as audience:
        await audience.add_viewers(VIEWERS)
        # Until they have shown more than could be coded, however late they came.
        async with asyncio.timeout(TIMEOUT_S):
            while sum(one.pictures for one in audience.viewers) <= (
                2 * FPS * (time.monotonic() - began_s)
            ):
                await asyncio.sleep(0.1)
        pictures = [viewer.pictures for viewer in audience.viewers]
        await audience.end_sender()
        offers, decoded = audience.admission.offers, [one.decoded for one in audience.viewers]
    assert [set(sizes) for sizes in decoded] == [{(320, 240)}] * VIEWERS
    report = json.loads((tmp_path / "publish.json").read_text())
    assert (offers, report["connections"]) == (1, 1)
    # The sender has coded and sent each picture once, whoever watched it.
    assert sum(pictures) > report["coded"]["video"]
