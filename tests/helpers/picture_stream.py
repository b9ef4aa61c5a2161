"""Both ends of a stream of pictures on virtual time, without encoder and decoder."""

from dataclasses import replace

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.media import AccessUnit, CaptureStamp, Quality
from kontur_av.rtp.annex_b import join_annex_b
from kontur_av.rtp.sender import RtpIdentity
from kontur_av.streams.video_receiver import VideoReceiver
from kontur_av.streams.video_sender import VideoSender

PERIOD_NS = NS_PER_S // 30
#: The receiver's clock is ahead of the sender's by this much.
AHEAD_NS = 7 * NS_PER_S
#: By codec: the heads of a key picture and of another one.
HEADS = {"h264": (b"\x65\x88", b"\x41\x88"), "h265": (b"\x26\x01\x88", b"\x02\x01\x88")}
MARKS = {Quality.FRESH: ".", Quality.DAMAGED: "D"}


def make_sender(ssrc=5, **changes) -> VideoSender:
    settings = {"cap_bps": 1_000_000, "fps": 30, "cname": "test"}
    return VideoSender(identity=RtpIdentity(ssrc, 65_530, 2**32 - 9), **settings | changes)


def make_receiver(**changes) -> VideoReceiver:
    return VideoReceiver(**{"ssrc": 6, "name": "view", "wall_offset_ns": -AHEAD_NS} | changes)


def coded(number, octets=300, *, codec="h264", key=False, sei=()) -> AccessUnit:
    """Return a picture in one slice."""
    nals = [*sei, HEADS[codec][not key] + bytes([7]) * octets]
    stamp = CaptureStamp(number * PERIOD_NS, number, "camera")
    return AccessUnit(join_annex_b(nals), stamp, key, codec)


class PictureStream:
    """Encodes in no time; a path takes 1 ms.

    Numbers of pictures: `lost` do not arrive; in those of `corrupt` the decoder finds damage; those
    of `late` stay in the decoder; those of `undecoded` it cannot decode.
    sei: NAL units ahead of a picture, by its number. heals: the encoder can heal.
    """

    def __init__(
        self,
        sender=None,
        receiver=None,
        *,
        codec="h264",
        way_back=True,
        sei=None,
        heals=False,
        **numbers,
    ):
        self.sender = sender or make_sender()
        self.receiver = receiver or make_receiver(codec=codec)
        self.codec, self.way_back, self.sei, self.heals = codec, way_back, sei or {}, heals
        self.lost, self.corrupt, self.late, self.undecoded = (
            numbers.pop(name, ()) for name in ("lost", "corrupt", "late", "undecoded")
        )
        assert not numbers
        self.codings, self.stamps, self.units = [], [], []

    def run(self, numbers, octets=300) -> "PictureStream":
        for number in numbers:
            self.step(number, octets)
        return self

    def step(self, number, octets=300):
        """Capture, send and show a picture."""
        sender, receiver, now_ns = self.sender, self.receiver, number * PERIOD_NS
        sender.handle_picture(CaptureStamp(now_ns, number, "camera"), now_ns)
        coding = sender.poll_encode(now_ns)
        assert coding is not None
        self.codings.append(coding)
        key, sei = self._makes_key(coding) or number == 0, self.sei.get(number, ())
        unit = coded(number, octets, codec=self.codec, key=key, sei=sei)
        heals = coding.lost is not None and not key
        sender.handle_access_unit(replace(unit, heals=heals), now_ns)
        there_ns = now_ns + AHEAD_NS + NS_PER_MS
        while (packet := sender.poll_transmit(now_ns)) is not None:
            if number not in self.lost:
                receiver.handle_packet(packet, there_ns)
        if (report := sender.poll_report(now_ns)) is not None:
            receiver.handle_report(report, there_ns)
        receiver.handle_timeout(there_ns + 20 * NS_PER_MS)
        for unit in iter(receiver.next_event, None):
            self.units.append(unit)
            if number in self.undecoded:
                receiver.handle_undecoded()
            elif number not in self.late:
                self.stamps.append(self.show(unit, corrupt=number in self.corrupt))
        feedback = receiver.poll_feedback(there_ns + 20 * NS_PER_MS)
        if feedback is not None and self.way_back:
            sender.handle_feedback(feedback, now_ns + 21 * NS_PER_MS)

    def show(self, unit, **found):
        """Return the stamp of a decoded unit."""
        capture_ns = self.receiver.capture_ns(unit.timestamp)
        return self.receiver.handle_picture(unit.timestamp, 64, 48, capture_ns, **found)

    @property
    def marks(self) -> str:
        """By picture that was decoded: `.` is fresh, `D` damaged, `-` withheld."""
        return "".join(MARKS[stamp.quality] if stamp else "-" for stamp in self.stamps)

    @property
    def keys(self) -> list[int]:
        """The pictures that the sender's wish made key pictures."""
        return [number for number, coding in enumerate(self.codings) if self._makes_key(coding)]

    def _makes_key(self, coding) -> bool:
        return coding.keyframe or (coding.lost is not None and not self.heals)

    @property
    def refreshes(self) -> list[tuple[int, float]]:
        """The changes of the refresh, and at which picture."""
        found = [(number, coding.refresh_s) for number, coding in enumerate(self.codings)]
        return [(number, refresh_s) for number, refresh_s in found if refresh_s is not None]
