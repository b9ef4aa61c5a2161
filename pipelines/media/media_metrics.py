"""What cameras, microphones, senders and displays count."""

from dataclasses import asdict, dataclass

from kontur_av.clock import NS_PER_MS
from kontur_av.errors import ConfigError
from kontur_av.media import VideoCodec
from kontur_av.metrics import Most, Newest
from kontur_av.streams.staleness import State
from pipelines.session.session_metrics import DatedEvent


@dataclass(frozen=True, slots=True, kw_only=True)
class CaptureMetrics:
    """A camera or a microphone."""

    #: Pictures or blocks of sound captured.
    captured: int = 0
    #: Faults that the source has survived.
    source_faults: int = 0
    #: Those captured from a browser page; only with pages.
    from_page: int | None = None
    #: Refused from pages: too old, of another size, or before the last captured.
    page_refused: int | None = None
    #: When it captured last.
    captured_ns: Most[int] | None = None
    #: The last fault of its source.
    source_fault: str | None = None
    #: `page` while a browser page has the input, else `own`; only with pages.
    live_source: str | None = None
    #: What dates its pictures: `source` (the camera itself) or `arrival`; of cameras only.
    dated_by: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class CompositionMetrics:
    """A camera that is composed of two, such as the stereo pair."""

    #: Pictures composed of two.
    paired: int = 0
    #: Pictures with one camera only.
    single: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class EncoderMetrics:
    """The encoder of a stream of pictures."""

    #: The library that codes the pictures, in words, and why it is a slower one.
    encoder: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class GainMetrics:
    """The cap of a picture that rises while haptic samples are left out."""

    #: What the cap gained from samples left out.
    gained_bits: int = 0
    #: How often that gain changed.
    gain_changes: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class DisplayMetrics:
    """What a display shows or plays of one stream."""

    #: Pictures shown or blocks played, without concealed sound.
    frames_displayed: int = 0
    #: How long what was shown was stale.
    stale_ns: int = 0
    stale_episodes: int = 0
    #: How long the picture stood still.
    frozen_ns: int = 0
    frozen_episodes: int = 0
    #: How long what was shown had damage.
    damaged_ns: int = 0
    damaged_episodes: int = 0
    #: How old what is shown is; null before the first picture.
    age_ns: Newest[int] | None = None
    state: State = State.NOTHING


@dataclass(frozen=True, slots=True, kw_only=True)
class SelectorMetrics:
    """The selector of the camera."""

    #: Changes of the camera.
    switches: int = 0
    #: The selected camera.
    selected: str | None = None
    #: Where a person wants the picture finest: X,Y,WIDTH,HEIGHT as shares of it, or `off`.
    focus: str | None = None
    #: When it changed, and which end asked for it: the newest 200.
    focuses: tuple[DatedEvent, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class FocusMetrics:
    """Where the uplink's picture is coded finer."""

    #: Pictures with a part that was coded finer.
    focused: int = 0
    #: That part of the newest picture: X,Y,WIDTH,HEIGHT as shares of it, or `off`.
    in_focus: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class SnapshotMetrics:
    """The snapshots of the displays."""

    #: Files written.
    snapshots: int = 0
    #: Files that could not be written.
    snapshots_failed: int = 0


@dataclass(frozen=True, kw_only=True)
class CodingCosts:
    """Durations on virtual time; defaults: medians of live sessions on two cores.

    capture_ms: from the capture of a picture to its arrival at the encoder: drawing, the stereo
        merge, the selector, and three wake-ups.
    encode_ms, decode_ms: of one picture, its wake-up included.
    encode_h265_ms, decode_h265_ms: of HEVC; estimated from H.264's and the codec's extra time.
    voice_encode_ms, voice_decode_ms: of one block of sound.
    """

    capture_ms: float = 4.0
    encode_ms: float = 6.0
    decode_ms: float = 3.0
    encode_h265_ms: float = 13.0
    decode_h265_ms: float = 3.5
    voice_encode_ms: float = 1.7
    voice_decode_ms: float = 0.3

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            if not 0 <= value <= 1000:
                option = f"--{name.replace('_', '-')}"
                raise ConfigError(f"{option} {value:g}: take 0 to 1000 milliseconds")

    def ns(self, name: str) -> int:
        """Return the duration `name` in ns, at least 1, so that an effect follows its cause."""
        cost_ms: float = getattr(self, f"{name}_ms")
        return max(1, round(cost_ms * NS_PER_MS))

    def picture_ns(self, name: str, codec: VideoCodec) -> int:
        return self.ns(name if codec == "h264" else f"{name}_{codec}")
