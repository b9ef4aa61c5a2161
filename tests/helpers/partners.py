"""Partners of a session across the Internet, as connections in the test's own event loop."""

import asyncio
import contextlib

from common import TIMEOUT_S

from kontur_av.clock import MonotonicClock
from kontur_av.media import AccessUnit, CaptureStamp
from pipelines.partner.ice_servers import IceServers
from pipelines.partner.media import PictureCame, SoundCame
from pipelines.partner.peer import RtcPeer
from pipelines.partner.whip import Keeper

SENDS = {"video": 1_500_000, "audio": 32_000}
#: An Opus packet of 20 ms of silence.
OPUS = b"\xf8\xff\xfe"
CLOCK = MonotonicClock()


def receiving(events):
    """Return what makes a partner that watches; it appends to `events`."""

    def make(servers):
        return RtcPeer(
            clock=CLOCK,
            sends={},
            receives=("video", "audio"),
            handle=events.append,
            servers=servers,
        )

    return make


def sending(servers):
    """Make a partner that sends."""
    return RtcPeer(clock=CLOCK, sends=SENDS, servers=servers)


@contextlib.asynccontextmanager
async def kept(url, make_peer, token, servers=IceServers):
    """A connection to `url`, once it stands."""
    keeper = Keeper(url, token=token, make_peer=make_peer, servers=servers, clock=CLOCK)
    running = asyncio.create_task(keeper.run())
    await until(lambda: running.done() or (keeper.peer is not None and keeper.peer.connected))
    try:
        yield keeper
    finally:
        keeper.stop()
        await running


async def until(true, timeout_s=TIMEOUT_S):
    async with asyncio.timeout(timeout_s):
        while not true():
            await asyncio.sleep(0.01)


async def send(units, send_unit, send_opus):
    """Send at 50 pictures a second."""
    for number, (data, key) in enumerate(units):
        now_ns = CLOCK.now_ns()
        send_unit(AccessUnit(data, CaptureStamp(now_ns, number, "camera"), key))
        send_opus(OPUS, CaptureStamp(now_ns, number, "voice"))
        await asyncio.sleep(1 / 50)


def pictures(events):
    """The access units of what came."""
    return [event.unit for event in events if isinstance(event, PictureCame)]


def sounds(events):
    """The blocks of sound of what came that were not concealed."""
    return [
        event.block
        for event in events
        if isinstance(event, SoundCame) and event.block.payload is not None
    ]
