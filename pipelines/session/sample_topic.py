"""A topic of numbered samples that is only written while it has readers."""

from itertools import count

from kontur_av.media import CaptureStamp
from kontur_av.topics.bus import TopicBus

#: Room for most samples; the topic makes more for a larger one.
_USUAL_OCTETS = 2 << 10


class SampleTopic:
    """A number counts the samples, also those that nobody reads."""

    def __init__(self, bus: TopicBus, topic: str) -> None:
        self._source, self._numbers = topic, count()
        self._writer = bus.writer(topic, max_octets=_USUAL_OCTETS)

    def handle_sample(self, octets: bytes, capture_ns: int, timestamp: int | None = None) -> None:
        """Publish a sample of this instant. timestamp: the 32-bit RTP timestamp of media."""
        number = next(self._numbers)
        if self._writer.has_readers():
            stamp = CaptureStamp(capture_ns, number, self._source, rtp_timestamp=timestamp)
            self._writer.publish_octets(octets, stamp)
