"""The parts of the time from an event to its picture, and the lead of force over that picture.

An event happens at any instant. The first picture that can show it is the next one that is captured
and arrives. So each picture stands for the events since the one before, and is weighted with the
time between the two. The means below are those of an event, not of a picture. Only means add up.
"""

from collections import Counter
from collections.abc import Mapping

from kontur_av.clock import NS_PER_MS, NS_PER_S
from pipelines.report.model import DirectionReport, Terms, VideoLead
from pipelines.session.setup.table import Setup
from telepresence.link.profile import LinkProfile

#: In the order in which they pass, with how each is obtained.
TERMS = {
    "camera": "half the time since the picture before: the wait for the next capture",
    "capture": "from the capture to the encoder: drawing or reading, stereo merge, selection",
    "encoding": "from the encoder's begin to the access unit",
    "queueing": "waiting for the channel before encoding, pacer, gateway, slots: what is left",
    "serialisation": "octets on the channel, headers included, at the rate that samples leave",
    "propagation": "the radio's delay in the second in which the picture was sent",
    "decoding": "from the last packet to the picture in shared memory",
    "display": "from there to the display's taking it; a screen's own delay is not in it",
}

#: Captures that lie farther apart are those of a pause, not of a camera.
LONGEST_GAP_NS = NS_PER_S

#: The measured parts; queueing, serialisation and propagation follow from `waiting` and `network`.
_MEASURED = ("camera", "capture", "waiting", "encoding", "network", "decoding", "display", "total")


class DelaySums:
    """Sums over the pictures of a stream, each weighted with the time since the picture before."""

    def __init__(self) -> None:
        self.pictures = 0
        self._weight = 0
        self._sums = dict.fromkeys(_MEASURED, 0)
        self._octets = self._packets = 0
        #: The weight of the pictures that were sent in each second.
        self._seconds: Counter[int] = Counter()

    def add(
        self,
        instants_ns: tuple[int, int, int, int, int, int, int],
        gap_ns: int,
        size: tuple[int, int],
    ) -> None:
        """A picture was displayed.

        instants_ns: captured, at the encoder, encoding begun, encoded, received, decoded, shown.
        gap_ns: since the capture of the one before. size: octets of RTP payload, and packets.
        """
        captured, came, begun, encoded, received, decoded, displayed = instants_ns
        parts = (
            gap_ns // 2,
            came - captured,
            begun - came,
            encoded - begun,
            received - encoded,
            decoded - received,
            displayed - decoded,
            displayed - captured + gap_ns // 2,
        )
        for name, part_ns in zip(_MEASURED, parts, strict=True):
            self._sums[name] += gap_ns * part_ns
        self._octets += gap_ns * size[0]
        self._packets += gap_ns * size[1]
        self._seconds[encoded // NS_PER_S] += gap_ns
        self._weight += gap_ns
        self.pictures += 1

    def mean_ns(self, part: str) -> float:
        """The mean of one of the measured parts; 0 without pictures."""
        return self._sums[part] / self._weight if self._weight else 0.0

    @property
    def octets_mean(self) -> float:
        """The mean RTP payload of a picture."""
        return self._octets / self._weight if self._weight else 0.0

    @property
    def packets_mean(self) -> float:
        return self._packets / self._weight if self._weight else 0.0

    def propagation_ns(self, setup: Setup, profile: LinkProfile, epoch_ns: int) -> float:
        """The mean delay of the radio (ns) in the seconds in which the pictures were sent.

        epoch_ns: the instant of the radio's time 0.
        """
        if not self._weight:
            return 0.0
        # The seed has no effect: the frames are empty, and the delay is not random.
        path = setup.radio_path(profile, seed=0, epoch_ns=epoch_ns)
        total = 0
        for second in sorted(self._seconds):
            now_ns = max(epoch_ns, second * NS_PER_S + NS_PER_S // 2)
            path.handle_frame(b"", now_ns)
            total += self._seconds[second] * path.delay_ns
            while path.poll_transmit(now_ns + path.delay_ns) is not None:
                pass
        return total / self._weight


def zone_bps(profile: LinkProfile, link: DirectionReport) -> float:
    """The rate (bit/s) that haptic samples left in the direction whose figures are `link`."""
    frames = link.sender.frames
    if not frames:
        return float(profile.media_bps)
    samples_octets = link.sender.octets.get("haptic", 0) / frames
    return (profile.largest_zone_octets - samples_octets) * 8 * NS_PER_S / profile.slot_ns


def video_lead(
    setup: Setup,
    way: DelaySums,
    link: DirectionReport,
    *,
    force_ns: float,
    epoch_ns: int,
    bypass: bool = False,
) -> VideoLead | None:
    """The lead of force over the uplink's picture of the same event; None without pictures.

    link: the uplink's figures in the report. force_ns: mean latency of the force. bypass: the
    programs are joined past gateways and radio, so that nothing is serialised or delayed.
    """
    if not way.pictures:
        return None
    profile = setup.uplink
    headers = link.sender.headers.get(setup.uplink_video.name, {})
    header_octets = headers.get("header_octets", 0) / max(1, headers.get("packets", 0))
    rate_bps = zone_bps(profile, link)
    propagation_ns = way.propagation_ns(setup, profile, epoch_ns)
    octets = way.octets_mean + header_octets * way.packets_mean
    # A part is no longer than the whole.
    network_ns = 0.0 if bypass else max(0.0, way.mean_ns("network"))
    propagation_ns = min(propagation_ns, network_ns)
    serialisation_ns = min(octets * 8 * NS_PER_S / rate_bps, network_ns - propagation_ns)
    left_over_ns = way.mean_ns("network") - serialisation_ns - propagation_ns
    video = {
        **{name: way.mean_ns(name) for name in TERMS if name in _MEASURED},
        "queueing": way.mean_ns("waiting") + left_over_ns,
        "serialisation": serialisation_ns,
        "propagation": propagation_ns,
        "total": way.mean_ns("total"),
    }
    # A sample has a reserved place in its frame, so it waits only for its slot and its cycle.
    force = dict.fromkeys((*TERMS, "total"), 0.0)
    delay_ns = 0.0 if bypass else min(propagation_ns, max(0.0, force_ns))
    force |= {
        "queueing": force_ns - delay_ns,
        "propagation": delay_ns,
        "total": force_ns,
    }
    return VideoLead(
        pictures=way.pictures,
        octets_mean=round(way.octets_mean, 1),
        zone_bps=round(rate_bps),
        video_ms=_in_ms(video),
        force_ms=_in_ms(force),
        lead_ms=_in_ms({name: video[name] - force[name] for name in video}),
    )


def _in_ms(terms: Mapping[str, float]) -> Terms:
    return Terms(**{name: round(terms[name] / NS_PER_MS, 3) for name in (*TERMS, "total")})
