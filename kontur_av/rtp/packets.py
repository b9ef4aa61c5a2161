"""aiortc's RTP and RTCP packets, without the rest of aiortc.

Importing `aiortc.rtp` runs aiortc's `__init__` first, which loads ICE, DTLS and SCTP: a quarter of
all that a session loads before anything flows, and nothing of it is used. So the one module is
loaded beneath an empty package of that name, which is taken away again: who imports aiortc later
gets the whole of it, with packets of its own.
"""

import sys
from importlib import import_module
from importlib.util import find_spec
from types import ModuleType
from typing import TYPE_CHECKING

__all__ = [
    "RTCP_PSFB_PLI",
    "RTCP_SDES",
    "AnyRtcpPacket",
    "RtcpByePacket",
    "RtcpPacket",
    "RtcpPsfbPacket",
    "RtcpRrPacket",
    "RtcpSenderInfo",
    "RtcpSrPacket",
    "RtpPacket",
    "pack_rtcp_packet",
]

if TYPE_CHECKING:
    from aiortc.rtp import (
        RTCP_PSFB_PLI,
        RTCP_SDES,
        AnyRtcpPacket,
        RtcpByePacket,
        RtcpPacket,
        RtcpPsfbPacket,
        RtcpRrPacket,
        RtcpSenderInfo,
        RtcpSrPacket,
        RtpPacket,
        pack_rtcp_packet,
    )


def _load() -> ModuleType:
    spec = None if "aiortc" in sys.modules else find_spec("aiortc")
    if spec is None or spec.submodule_search_locations is None:
        return import_module("aiortc.rtp")
    bare = ModuleType("aiortc")
    bare.__path__ = list(spec.submodule_search_locations)
    sys.modules["aiortc"] = bare
    try:
        return import_module("aiortc.rtp")
    except ImportError:
        # A version whose module needs its package: the whole of it, then.
        pass
    finally:
        for name in [name for name in sys.modules if name.partition(".")[0] == "aiortc"]:
            del sys.modules[name]
    return import_module("aiortc.rtp")


if not TYPE_CHECKING:
    _module = _load()
    globals().update({name: getattr(_module, name) for name in __all__})
