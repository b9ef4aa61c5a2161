"""What the leg to a partner counts."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from kontur_av.metrics import Newest


@dataclass(frozen=True, slots=True, kw_only=True)
class RtcStreamMetrics:
    """One stream of the leg to a partner, in RTP packets."""

    #: Packets sent or received.
    packets: int = 0
    #: Octets of their payload.
    octets: int = 0
    #: Packets lost, by the receiver's reports.
    lost: int = 0
    #: Packets asked for again (NACK).
    asked: int = 0
    #: Packets sent again.
    repeated: int = 0
    #: Key pictures asked for (PLI, FIR).
    keys_asked: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class RtcMetrics:
    """The leg to a partner across the Internet."""

    #: Connections of partners that stood.
    connections: int = 0
    #: Restarts of ICE.
    ice_restarts: int = 0
    #: HTTP requests refused: `token`, `unknown_senders`, `offers`, `viewers` or `hand`.
    refused: Mapping[str, int] = field(default_factory=dict)
    #: Unusable offers, and packets that were not RTP or RTCP.
    garbage: int = 0
    #: Connections and requests ended by an error of this software; see the error stream.
    faults: int = 0
    #: Haptic samples `taken` from the partner, `given` to it, `left_out` for a slow network.
    samples: Mapping[str, int] = field(default_factory=dict)
    #: How often the rate of the picture was lowered.
    rate_lowered: int = 0
    #: Connections that stand.
    partners: Newest[int] = 0
    #: Of the picture that is coded for the partner.
    rate_bps: Newest[int] = 0
    #: The newest connection's kinds of address, ours and theirs: host, srflx, prflx, relay.
    route: str | None = None
    #: Of the newest answer to a report.
    round_trip_ns: Newest[int] | None = None
    #: Sent `rtc_video`, `rtc_speech` and the downlink's; received `rtc_camera`, `rtc_voice`.
    streams: Mapping[str, RtcStreamMetrics] = field(default_factory=dict)
