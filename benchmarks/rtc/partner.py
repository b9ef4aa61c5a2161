"""A partner that decodes nothing, for a network of its own: it watches all, and sends.

python -m benchmarks.rtc.partner BASE TOKEN FILE      until SIGTERM
"""

import asyncio
import signal
import struct
import sys
from collections.abc import Sequence
from itertools import cycle
from pathlib import Path

from benchmarks.page.footage import FPS
from kontur_av.clock import MonotonicClock
from kontur_av.media import AccessUnit, CaptureStamp
from pipelines.partner.description import Kind
from pipelines.partner.ice_servers import IceServers
from pipelines.partner.peer import RtcPeer
from pipelines.partner.whip import Keeper

_HEAD = struct.Struct("<I?")
_RATES: dict[Kind, int] = {"video": 1_500_000, "audio": 32_000}
#: An Opus packet of 20 ms of silence.
_SILENCE = b"\xf8\xff\xfe"


def write_units(path: Path, units: Sequence[tuple[bytes, bool]]) -> None:
    """Write coded pictures, for `read_units`."""
    path.write_bytes(b"".join(_HEAD.pack(len(data), key) + data for data, key in units))


def read_units(path: Path) -> list[tuple[bytes, bool]]:
    """Return what `write_units` wrote."""
    octets, at, found = path.read_bytes(), 0, []
    while at < len(octets):
        size, key = _HEAD.unpack_from(octets, at)
        at += _HEAD.size
        found.append((octets[at : at + size], key))
        at += size
    return found


async def take_part(base: str, token: str, units: Sequence[tuple[bytes, bool]]) -> None:
    """Watch both programmes, and send the units over and over, until SIGTERM."""
    clock, stop = MonotonicClock(), asyncio.Event()
    asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, stop.set)

    def watching(servers: IceServers) -> RtcPeer:
        return RtcPeer(clock=clock, sends={}, receives=("audio", "video"), servers=servers)

    def sending(servers: IceServers) -> RtcPeer:
        return RtcPeer(clock=clock, sends=_RATES, servers=servers)

    keepers = [
        Keeper(f"{base}/{path}", token=token, make_peer=make, servers=IceServers, clock=clock)
        for path, make in (
            ("whep/uplink", watching),
            ("whep/downlink", watching),
            ("whip", sending),
        )
    ]
    running = [asyncio.create_task(keeper.run()) for keeper in keepers]
    for number, (data, key) in enumerate(cycle(units)):
        if stop.is_set():
            break
        peer, now_ns = keepers[-1].peer, clock.now_ns()
        if peer is not None:
            peer.send_unit(AccessUnit(data, CaptureStamp(now_ns, number, "bench"), key))
            peer.send_opus(_SILENCE, CaptureStamp(now_ns, number, "bench"))
        await asyncio.sleep(1 / FPS)
    for keeper in keepers:
        keeper.stop()
    await asyncio.wait(running, timeout=2)


if __name__ == "__main__":
    asyncio.run(take_part(sys.argv[1], sys.argv[2], read_units(Path(sys.argv[3]))))
