"""What ends a way to a partner ends all that ran for it."""

import asyncio

import aioice.ice
import pytest

from kontur_av.errors import ConfigError
from pipelines.partner.ice_servers import IceServers
from pipelines.partner.transport import RtcTransport


def transport(*, controlling):
    return RtcTransport(
        controlling=controlling,
        servers=IceServers(),
        handle_rtp=lambda packet: None,
        handle_rtcp=lambda packet: None,
    )


async def test_a_way_that_is_found_after_the_end_is_not_taken():
    one, other = transport(controlling=True), transport(controlling=False)
    first, second = await one.gather(), await other.gather()
    find_way = one._find_way

    async def find_it_late(connection, peer):
        await find_way(connection, peer)
        await one.close()

    one._find_way = find_it_late
    peer = asyncio.create_task(other.connect(first, role="server"))
    with pytest.raises(ConnectionError, match="closed"):
        await one.connect(second, role="client")
    peer.cancel()
    await asyncio.gather(peer, return_exceptions=True)
    await other.close()
    names = [task.get_coro().__qualname__ for task in asyncio.all_tasks()]
    assert not [name for name in names if "_receive" in name], names


async def test_a_host_with_loopback_only_is_told_so(monkeypatch):
    monkeypatch.setattr(aioice.ice, "get_host_addresses", lambda **_: [])
    end = transport(controlling=True)
    try:
        with pytest.raises(ConfigError, match="this host has loopback only"):
            await end.gather()
    finally:
        await end.close()
