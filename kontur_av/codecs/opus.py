"""Blocks of sound to Opus packets of one constant size, and back (RFC 6716, RFC 7587)."""

import weakref
from dataclasses import replace
from typing import Any

import numpy as np

from kontur_av.clock import NS_PER_S
from kontur_av.codecs import libopus
from kontur_av.errors import ConfigError, ProtocolError
from kontur_av.media import AUDIO_CLOCK_HZ, BLOCK_SAMPLES, MAX_OPUS_SAMPLES, CaptureStamp, Pcm

MAX_PACKET_SAMPLES = MAX_OPUS_SAMPLES

#: Samples a packet may cover: 10, 20, 40 or 60 ms. Voice mode codes nothing shorter (RFC 6716
#: section 2.1.4).
FRAME_SAMPLES = (480, 960, 1920, 2880)
_LOWEST_BPS, _HIGHEST_BPS = 6_000, 510_000  # RFC 6716 section 2.1.1

#: From this rate on the encoder searches a little less. Measured on the speech in `samples/`, 20 ms
#: a packet, PESQ wideband and time a packet: at 8 kbit/s complexity 2 gives 1.61 for 0.24 ms, 5
#: gives 1.72 for 0.32, 8 1.82 for 0.63, 10 the same; at 61 kbit/s 1 gives 3.60 for 0.35 ms, 5
#: 4.31 for 0.69, 10 4.42 for 1.29.
#:
#: No in-band copies of the packet before (RFC 6716 section 2.1.7): libopus makes none below 12
#: kbit/s, whatever loss it is told of; at 61 kbit/s they turn 4.31 into 3.87 where nothing is lost.
#: They would pay from 1 % of loss on (3.30 against 1.83 at 5 %), for 20 ms more of delay.
_AMPLE_BPS = 24_000


def bitrate_under_cap(cap_bps: int, frame_samples: int = BLOCK_SAMPLES) -> int:
    """The largest bit rate of constant packets that keeps a hard cap even when sends jitter.

    At exactly `cap_bps` there is no room at all: one packet that leaves a millisecond early and
    a 1 s window holds 51 of them. Here 52 packets of 20 ms still fit (8 kbit/s: 19 octets each,
    7600 bit/s; 64 kbit/s: 153 octets, 61 200 bit/s), so a packet may be 20 ms early or late.
    Raises ConfigError, which names the cap, where Opus has no rate for it: with packets of 20 ms
    below 6.24 and above 530.4 kbit/s.
    """
    packets = -(-AUDIO_CLOCK_HZ // frame_samples) + 2
    octets = cap_bps // 8 // packets
    least = -(-_LOWEST_BPS * frame_samples // (8 * AUDIO_CLOCK_HZ))
    most = _HIGHEST_BPS * frame_samples // (8 * AUDIO_CLOCK_HZ)
    if not least <= octets <= most:
        of_octets = packets * 8 / 1000
        raise ConfigError(
            f"a cap of {cap_bps / 1000:g} kbit/s: Opus voice takes {least * of_octets:g} to "
            f"{most * of_octets:g}"
        )
    return -(-octets * 8 * AUDIO_CLOCK_HZ // frame_samples)


#: libopus' look-ahead at 48 kHz in every mode but restricted low delay: the sound of a packet
#: begins so much before the block that it was made from.
LOOKAHEAD_SAMPLES = 312


def heard_stamp(stamp: CaptureStamp) -> CaptureStamp:
    """The stamp of what a listener hears of the packet that was made from the block of `stamp`.

    With it in the sender reports, the codec's look-ahead is part of every latency and of lip-sync.
    """
    lookahead_ns = LOOKAHEAD_SAMPLES * NS_PER_S // AUDIO_CLOCK_HZ
    return replace(stamp, capture_ns=stamp.capture_ns - lookahead_ns)


class OpusEncoder:
    """Voice mode, mono, 48 kHz, hard constant bit rate: every packet has `packet_octets` octets.

    bitrate_bps: bits of the packets alone. 20 ms at 8000 bit/s give 20 octets, at 64 000 160.
    frame_samples: samples a packet, one of `FRAME_SAMPLES`.
    complexity: libopus' 0..10, how hard it searches. None: 5 from 24 kbit/s on, else 8.

    Raises ConfigError for what libopus cannot do, or when there is no libopus.
    """

    def __init__(
        self, *, bitrate_bps: int, frame_samples: int = BLOCK_SAMPLES, complexity: int | None = None
    ) -> None:
        if frame_samples not in FRAME_SAMPLES:
            raise ConfigError(f"Opus frame of {frame_samples} samples: take one of {FRAME_SAMPLES}")
        if not _LOWEST_BPS <= bitrate_bps <= _HIGHEST_BPS:
            raise ConfigError(
                f"Opus at {bitrate_bps} bit/s: take a rate from {_LOWEST_BPS} to {_HIGHEST_BPS}"
            )
        if complexity is None:
            complexity = 5 if bitrate_bps >= _AMPLE_BPS else 8
        self.frame_samples = frame_samples
        self.packet_octets = bitrate_bps * frame_samples // (8 * AUDIO_CLOCK_HZ)
        self._encoder = libopus.opuslib().Encoder(AUDIO_CLOCK_HZ, 1, "voip")
        weakref.finalize(self, _free, self._encoder, "encoder_state")
        self._encoder.vbr = 0
        # The rate of whole octets, because libopus rounds the octets to the nearest.
        self._encoder.bitrate = self.packet_octets * 8 * AUDIO_CLOCK_HZ // frame_samples
        self._encoder.complexity = complexity
        self.lookahead_samples: int = self._encoder.lookahead

    def encode(self, samples: Pcm) -> bytes:
        """One packet of `packet_octets` octets from int16 samples of shape (frame_samples,)."""
        if samples.shape != (self.frame_samples,) or samples.dtype != np.int16:
            raise ValueError(f"{samples.dtype}{samples.shape}, not int16({self.frame_samples},)")
        packet: bytes = self._encoder.encode(samples.tobytes(), self.frame_samples)
        return packet


class OpusDecoder:
    """Opus packets to mono sound at 48 kHz, and something to hear where a packet is missing."""

    def __init__(self, *, frame_samples: int = BLOCK_SAMPLES) -> None:
        opuslib = libopus.opuslib()
        self.frame_samples = frame_samples
        self._error: type[Exception] = opuslib.OpusError
        self._decoder = opuslib.Decoder(AUDIO_CLOCK_HZ, 1)
        weakref.finalize(self, _free, self._decoder, "decoder_state")

    def decode(self, packet: bytes) -> Pcm:
        """The packet's samples, int16 of shape (n,) with n up to 5760; also sets the length that
        `conceal` stands in for.

        Raises ProtocolError on what is no Opus packet; the decoder goes on with the next one.
        """
        if not packet:
            raise ProtocolError("an empty Opus packet")
        samples = self._received(packet, MAX_PACKET_SAMPLES)
        self.frame_samples = len(samples)
        return samples

    def recover(self, following: bytes, samples: int) -> Pcm:
        """A lost packet of `samples` samples from the coarse copy in the one after it.

        That is Opus' in-band error correction (RFC 6716 section 2.1.7); without such a copy it is
        the same as `conceal`. int16 of shape (samples,). `following` is still to be decoded.
        Raises ProtocolError on what is no Opus packet.
        """
        return self._received(following, samples, decode_fec=True)

    def conceal(self, samples: int | None = None) -> Pcm:
        """libopus' guess at what is missing: int16 of shape (samples,), fading out from packet to
        packet. samples: a multiple of 2.5 ms, at most 5760; None: as the packet before had.
        """
        # libopus takes an empty packet for a lost one (opus_decode).
        wanted = self.frame_samples if samples is None else samples
        return np.frombuffer(self._decoder.decode(b"", wanted), np.int16)

    def _received(self, packet: bytes, most_samples: int, *, decode_fec: bool = False) -> Pcm:
        try:
            octets = self._decoder.decode(packet, most_samples, decode_fec)
        except self._error as error:
            raise ProtocolError(f"no Opus packet: {error}") from error
        return np.frombuffer(octets, np.int16)


def _free(coder: Any, state: str) -> None:
    # At the interpreter's end opuslib's destructor would fail: it needs modules that are gone.
    coder.__del__()
    delattr(coder, state)
