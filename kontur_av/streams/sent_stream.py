"""What the reports of `send` and of a session say alike of a stream that was sent."""

from kontur_av.metrics import Flat
from kontur_av.report import PayloadRates
from kontur_av.streams.paced_sender import SenderCounts


class SentStream(PayloadRates, frozen=True, kw_only=True):
    """A stream as it was sent."""

    #: The largest rate of RTP payload over any second.
    cap_bps: int
    #: Width and height as captured and displayed; of pictures only.
    size: tuple[int, int] | None = None
    #: Width and height as coded.
    coded_size: tuple[int, int] | None = None
    #: The library that codes the pictures, in words, and why it is a slower one.
    encoder: str | None = None
    sender: Flat[SenderCounts]
