"""The typed table that describes a setup. A setup that cannot work is refused when it is built.

A user's own setup is a TOML file with the same fields: `pipelines.session.setup.setup_file`.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from math import ceil
from typing import Literal, get_args, get_origin

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.codecs.coding import PREFERENCES, Preference, coded_rate_for, coded_size_for
from kontur_av.codecs.opus import bitrate_under_cap
from kontur_av.errors import ConfigError, number, one_of, refused
from kontur_av.media import VIDEO_CODECS, VideoCodec, check_size
from kontur_av.streams.budget import Pacer
from pipelines.session.setup.composition import STEREO, STEREO_PAIR, Composition
from pipelines.session.setup.former_names import INPUTS
from pipelines.session.setup.segments import Direction
from telepresence.haptics.axes import AxisName, AxisSettings, more_axes, sample_octets
from telepresence.haptics.envelope import SafetyLimits
from telepresence.haptics.joystick_controller import PRESS_RATIO
from telepresence.haptics.mediated.wall import WALL_OCTETS
from telepresence.haptics.pacing import (
    FEEDBACK_HZ,
    LEAST_COMMAND_HZ,
    MOST_COMMAND_HZ,
    OTHERS_HZ,
    lasts_ns,
)
from telepresence.haptics.robot import Mark
from telepresence.haptics.sample import SAMPLE_OCTETS
from telepresence.link import arithmetic
from telepresence.link.flows import Level
from telepresence.link.profile import DOWNLINK, UPLINK, LinkProfile, Repair
from telepresence.link.radio.path import RadioPath
from telepresence.link.radio.profile import RadioProfile, built_in_radio, delayed
from telepresence.link.repair.symbols import has_codes
from telepresence.world import DEFAULT_SCENES
from telepresence.world.board import BoardView

GROUND_MIC, OPERATOR_CAMERA, OPERATOR_MIC = "ground_mic", "operator_camera", "operator_mic"

#: The lowest cap that an encoder takes.
LEAST_VIDEO_BPS = 10_000
VOICE_PACKETS_PER_S = 50  # RFC 7587: one packet per 20 ms
#: Small enough that no part of a coded picture takes more than a picture's share of the link.
VIDEO_PAYLOAD_OCTETS = 1000
#: The radio that does nothing to frames.
NO_RADIO = "cable"
#: Unless a setup says otherwise, what is shown is stale when it is older than the radio's delay,
#: this time and this many periods together.
_STALE_NS = 100 * NS_PER_MS
_STALE_PERIODS = 4
#: A telecommand carries at most this many octets of a camera's name (`dictionary.toml`).
MAX_CAMERA_OCTETS = 10
#: A session takes this many ports, from its base port on.
PORTS = 40


@dataclass(frozen=True, kw_only=True)
class VideoStream:
    """A stream of pictures: its hard cap of RTP payload in bit/s, picture size and rate.

    cap_bps: the most RTP payload in any second; 20 to 20000 kbit/s. With `deadband = "picture"` up
        to twice as much.
    width: width and height of the pictures, both even.
    fps: pictures a second of its cameras, 1 to 120. As many are coded as the cap has bits for.
    prefer: "latency" codes more and smaller pictures of a fast camera.
    stale_after_ms: older pictures are marked as stale. By default the radio's longest delay, 100 ms
        and four periods together.
    coded: the size in which pictures are coded; default: the largest for which the cap has bits.
    codec: `h264`, or `h265` for a better picture at more computing.
    least_fps: pictures a second that are sent at least, also for repair or a slow path.
    least_cap_bps: the cap on a path between two machines that carries less; default: a third of it.
    """

    name: str
    cap_bps: int
    width: int = 640
    height: int = 480
    fps: float = 30
    prefer: Preference = "quality"
    coded: tuple[int, int] | None = None
    codec: VideoCodec = "h264"
    stale_after_ms: float | None = None
    least_fps: int = 20
    least_cap_bps: int | None = None

    def __post_init__(self) -> None:
        if self.least_fps < 1:
            raise ConfigError(f"{self.name}: least_fps of {self.least_fps}; take at least 1")
        if not 20_000 <= self.cap_bps <= 20_000_000:
            raise ConfigError(
                f"{self.name}: cap of {self.cap_bps / 1000:g} kbit/s; video takes 20 to 20000"
            )
        if not LEAST_VIDEO_BPS <= self.least_bps <= self.cap_bps:
            raise ConfigError(
                f"{self.name}: least cap of {self.least_bps / 1000:g} kbit/s; take 10 to the cap, "
                f"{self.cap_bps / 1000:g}"
            )
        fps = number(self.fps, f"{self.name}: fps", least=1, most=120)
        object.__setattr__(self, "fps", fps)
        one_of(self.prefer, PREFERENCES, f"{self.name}: prefer")
        one_of(self.codec, VIDEO_CODECS, f"{self.name}: codec")
        _check_stale_after(self)
        check_size(self.width, self.height)
        if self.coded is not None:
            check_size(*self.coded)
            if self.coded[0] > self.width or self.coded[1] > self.height:
                raise ConfigError(
                    f"{self.name}: pictures of {self.width}x{self.height} coded as "
                    f"{self.coded[0]}x{self.coded[1]}: take no larger size, or leave coded out"
                )

    @property
    def least_bps(self) -> int:
        """The lowest cap on a path that carries less."""
        least_bps = self.least_cap_bps
        return max(self.cap_bps // 3, LEAST_VIDEO_BPS) if least_bps is None else least_bps

    @property
    def coded_size(self) -> tuple[int, int]:
        size = self.width, self.height
        return self.coded or coded_size_for(*size, self.coded_hz, self.cap_bps, self.codec)

    @property
    def period_ns(self) -> int:
        """The time from one picture of its cameras to the next."""
        return round(NS_PER_S / self.fps)

    @property
    def coded_hz(self) -> float:
        """The pictures a second for which the encoder is made."""
        return coded_rate_for(self.fps, self.cap_bps, self.prefer)

    @property
    def payload_octets(self) -> int:
        """The largest RTP payload in octets; a low cap lets only smaller ones through at once."""
        return min(VIDEO_PAYLOAD_OCTETS, Pacer(cap_bps=self.cap_bps).max_payload_octets)

    @property
    def packets_per_s(self) -> int:
        """The packets a second if pictures of equal size fill the cap."""
        packets = ceil(self.cap_bps / (8 * self.coded_hz * self.payload_octets))
        return ceil(self.coded_hz * packets)


@dataclass(frozen=True, kw_only=True)
class VoiceStream:
    """An Opus stream in voice mode, mono 48 kHz, constant bit rate: RTP payload in bit/s.

    cap_bps: its constant rate of RTP payload, 6.24 to 128 kbit/s.
    stale_after_ms: older sound is stale; by default as of pictures, with periods of 20 ms.
    """

    name: str
    cap_bps: int
    stale_after_ms: float | None = None

    def __post_init__(self) -> None:
        if self.cap_bps > 128_000:
            raise ConfigError(
                f"{self.name}: a cap of {self.cap_bps / 1000:g} kbit/s; take at most 128"
            )
        with refused(self.name, ConfigError):
            bitrate_under_cap(self.cap_bps)
        _check_stale_after(self)


def _check_stale_after(stream: VideoStream | VoiceStream) -> None:
    after_ms = stream.stale_after_ms
    if after_ms is not None and not 10 <= after_ms <= 600_000:
        raise ConfigError(f"{stream.name}: stale after {after_ms:g} ms; take 10 to 600000")


#: What happens to the room of haptic samples that nobody would feel. `off`: no sample is left out.
#: `picture`: the video's cap rises. `latency`: the same pictures are sent sooner.
Deadband = Literal["off", "picture", "latency"]
PathForm = Literal["slots", "compact"]
#: Slots of which the frames go in one datagram.
BATCHES_MS = (1, 2, 4)

#: What the operator's hand feels. `direct`: the robot's delayed force. `mediated`: a wall that the
#: robot's side estimates and the joystick's side renders. `auto`: that wall, and directly what it
#: does not explain. `adaptive`: as `direct`, and as `auto` from a round trip of 60 ms on.
HandMode = Literal["adaptive", "direct", "mediated", "auto"]
#: Whether the hand feels the robot's force.
ForceMode = Literal["felt", "none"]
#: From this measured round trip on, `adaptive` renders walls.
WALLS_FROM_NS = 60 * NS_PER_MS
#: Below 1 the robot would press less than the hand feels.
LEAST_PRESS_RATIO, MOST_PRESS_RATIO = 1.0, 10.0

#: What a partner's joystick may drive. `none`: nothing. `shared`: the robot, in the place of the
#: joystick in space, once an operator has handed it over. `second`: an arm of its own. `board`:
#: nothing; the joystick in space drives the partner's robot in the Russian experiment.
PartnerArm = Literal["none", "shared", "second", "board"]

#: What of the uplink video is coded finer. `off`: nothing. `stylus`: what is around its tip.
RegionChoice = Literal["off", "stylus"]
#: Which cameras are recorded. `carried`: as the streams carry them, others at 5 Hz. `all`: every
#: camera at its full rate. `auto`: all, if the disk has room for an hour of them; else `carried`.
RecordedCameras = Literal["auto", "all", "carried"]
#: The built-in scenes that see the task board.
_BOARD_SCENES = ("left", "right", "static", "head")

#: Walls are told this often on average. Uplink capacity is kept for them.
_WALLS_PER_S = 2


@dataclass(frozen=True, kw_only=True)
class RtcLeg:
    """The leg to a partner across the Internet, by WebRTC (docs/webrtc.md), beside the radio.

    video_bps: of the selected camera, coded for it; 100 to 20000 kbit/s.
    voice_bps: of ground control's voice, coded for it; 6 to 128 kbit/s.
    taken_bps: the most that its picture may take; 100 to 20000 kbit/s.
    """

    video_bps: int = 1_500_000
    voice_bps: int = 32_000
    taken_bps: int = 1_500_000

    def __post_init__(self) -> None:
        for name, bps in (("video", self.video_bps), ("taken", self.taken_bps)):
            if not 100_000 <= bps <= 20_000_000:
                raise ConfigError(f"rtc: {name}_kbps of {bps / 1000:g}; take 100 to 20000")
        if not 6_000 <= self.voice_bps <= 128_000:
            raise ConfigError(f"rtc: voice_kbps of {self.voice_bps / 1000:g}; take 6 to 128")


@dataclass(frozen=True, kw_only=True)
class Playback:
    """By end: the loudspeaker that plays its voice; None: it is silent. See `loudspeaker`.

    ground: of `downlink_voice`: default, alsa:DEVICE or pulse:SINK; without it silent.
    space: the same of `uplink_voice`.
    """

    ground: str | None = None
    space: str | None = None


@dataclass(frozen=True, kw_only=True)
class Setup:
    """A telepresence session: its cameras, its streams and their caps, its link and its radio.

    name: in reports; default: the file's.
    cameras: what the operator can select; the first is on at the start. `stereo` is merged from the
        inputs `left` and `right`; any other (1 to 10 printable ASCII characters) is the input of
        that name, or one of `composed`.
    composed: by their names, cameras that show two inputs in one picture (docs/cameras.md).
    sources: by input its source (docs/cameras.md).
    radio: a profile, built in or a file (docs/simulation.md#the-radio).
    radio_delay_ms: of the `cable`, one way.
    deadband: what samples left out give the uplink video (docs/haptics.md).
    repair: what restores lost frames (docs/architecture.md#the-link). `auto` goes without where
        there is no room, or the other end does not know it.
    path: the datagrams between two machines (docs/two-machines.md).
    path_batch_ms: the frames of 1, 2 or 4 ms are in one of these.
    hand: what the operator feels (docs/haptics.md).
    force: `none`: the hand feels nothing. Commands go at `command_hz`, the robot's state at 50 Hz,
        and pictures get the room.
    command_hz: commands a second with `force = "none"`, 50 to 250.
    press_ratio: how many times as hard as the hand feels the robot may press on a rendered wall,
        1 to 10 (docs/haptics.md).
    axes: what the hand moves, of x, y, z, roll, pitch, yaw, gripper and up to three of the robot's
        own. Each behind x and y takes 5 octets of each frame.
    axis: tables of what there is to say of one of these.
    rtc: the leg to a partner across the Internet; None: there is none.
    partner_arm: what a partner's joystick may drive (docs/webrtc.md).
    tasks: whether a live session has tasks (docs/ground-control.md).
    safety: when the robot may follow the hand, and how fast (docs/safety.md).
    marks: what stands in the robot's workspace, by name, for the maps of the pages. With any, or
        with a robot of one's own, they show these instead of the built-in task board.
    playback: where the operator in space, and the ground, hear the voice.
    recorded_cameras: as `--record-cameras`; `auto` by the disk (docs/recordings.md).
    region: what of the uplink video is coded finer where no person says: the robot's tip.
    region_points: by camera of your own, the corners of the task board in its pictures, in pixels:
        upper left, upper right, lower right, lower left.
    base_port: the first of the 40 UDP ports on loopback.
    """

    name: str
    uplink_video: VideoStream
    cameras: tuple[str, ...]
    composed: Mapping[str, Composition] = field(
        default_factory=dict,
        metadata={"like": 'a table of tables, like work = {compose = ["head", "wrist"]}'},
    )
    uplink_voice: VoiceStream | None = None
    downlink_video: VideoStream | None = None
    downlink_voice: VoiceStream | None = None
    sources: Mapping[str, str] = field(
        default_factory=dict, metadata={"like": 'a table of texts, like left = "v4l2:/dev/video0"'}
    )
    uplink: LinkProfile = UPLINK
    downlink: LinkProfile = DOWNLINK
    radio: RadioProfile | str = NO_RADIO
    radio_delay_ms: float = 0.0
    deadband: Deadband = "off"
    repair: Repair = "auto"
    path: PathForm = "slots"
    path_batch_ms: int = 1
    hand: HandMode = "adaptive"
    force: ForceMode = "felt"
    command_hz: int = 100
    press_ratio: float = PRESS_RATIO
    axes: tuple[str, ...] = field(
        default=("x", "y"), metadata={"like": 'a list of names, like ["x", "y", "z", "gripper"]'}
    )
    axis: Mapping[str, AxisSettings] = field(
        default_factory=dict, metadata={"like": 'tables, like [axis.pan] with kind = "rotary"'}
    )
    rtc: RtcLeg | None = None
    partner_arm: PartnerArm = "none"
    tasks: bool = False
    safety: SafetyLimits = field(default_factory=SafetyLimits)
    marks: Mapping[str, Mark] = field(
        default_factory=dict,
        metadata={"like": "a table of tables, like bin = {x_m = 0.1, y_m = 0.02}"},
    )
    playback: Playback = field(default_factory=Playback)
    recorded_cameras: RecordedCameras = "auto"
    region: RegionChoice = "off"
    region_points: Mapping[str, tuple[tuple[float, float], ...]] = field(
        default_factory=dict,
        metadata={"like": "a table of points, like wrist = [[x, y], [x, y], [x, y], [x, y]]"},
    )
    #: Below 32768, where Linux takes the ports of sockets that ask for any port.
    base_port: int = 27_000

    def __post_init__(self) -> None:
        if not self.cameras:
            raise ConfigError(f"setup {self.name}: cameras is empty; name at least one")
        for camera in self.cameras:
            if self.cameras.count(camera) > 1:
                raise ConfigError(f"setup {self.name}: camera {camera} is named twice")
        self._check_composed()
        for camera in (*self.cameras, *self.camera_inputs):
            _check_camera(camera)
            if camera in (GROUND_MIC, OPERATOR_CAMERA, OPERATOR_MIC, *INPUTS):
                raise ConfigError(
                    f"setup {self.name}: camera {camera} has the name of another input; rename it"
                )
        for each in fields(self):
            if get_origin(each.type) is Literal:
                one_of(getattr(self, each.name), get_args(each.type), each.name)
        self._check_partner_arm()
        self._check_playback()
        if self.rtc is not None and self.downlink_video and self.downlink_video.codec != "h264":
            raise ConfigError(
                "downlink_video: it goes on to the browsers of a partner, which take H.264: "
                'take codec = "h264", or leave [rtc] out'
            )
        self._make_room()
        self._take_pace()
        self._take_repair()
        if self.path_batch_ms not in BATCHES_MS:
            raise ConfigError(f"path_batch_ms {self.path_batch_ms}: take 1, 2 or 4")
        if not 0 <= self.radio_delay_ms <= 10_000:
            raise ConfigError(f"radio delay of {self.radio_delay_ms:g} ms; take 0 to 10000")
        radio = self._named_radio
        if self.radio_delay_ms and radio.name != NO_RADIO:
            raise ConfigError(
                f"radio {radio.name} has a delay of its own: leave out the delay of "
                f"{self.radio_delay_ms:g} ms, or take radio {NO_RADIO}"
            )
        delay_ms = self.radio_profile.longest_delay_ns / NS_PER_MS
        for stream in self.streams:
            if stream.stale_after_ms is not None and stream.stale_after_ms <= delay_ms:
                raise ConfigError(
                    f"{stream.name}: stale after {stream.stale_after_ms:g} ms, but the radio takes "
                    f"{delay_ms:g}: take more, or leave stale_after_ms out"
                )
        if not 1024 <= self.base_port <= 65_536 - PORTS:
            raise ConfigError(f"base port {self.base_port}: take 1024 to {65_536 - PORTS}")
        for name in self.sources:
            if name not in self.inputs:
                raise ConfigError(
                    f"source {name}: setup {self.name} has no such input: it has "
                    f"{', '.join(self.inputs)}; another camera needs a setup file of your own that "
                    f"names it in cameras (docs/setup-file.md)"
                )
        for name in self.inputs:
            self.source(name)
        self._check_region()
        for direction in Direction:
            self.need(direction)

    @cached_property
    def radio_profile(self) -> RadioProfile:
        """The profile of the radio, with the setup's own delay."""
        profile = self._named_radio
        return delayed(profile, self.radio_delay_ms) if self.radio_delay_ms else profile

    @cached_property
    def more_axes(self) -> tuple[AxisName, ...]:
        """The axes behind x and y."""
        return more_axes(self.axes, self.axis)

    def _check_playback(self) -> None:
        for end, voice in (("ground", "downlink_voice"), ("space", "uplink_voice")):
            where: str | None = getattr(self.playback, end)
            if where is None:
                continue
            if getattr(self, voice) is None:
                raise ConfigError(f"playback.{end}: there is no {voice} to play: add [{voice}]")
            if where != "default" and not re.fullmatch(r"(alsa|pulse):.+", where):
                raise ConfigError(
                    f"playback.{end} {where!r}: write default, alsa:DEVICE or pulse:SINK"
                )

    def _check_composed(self) -> None:
        for name, made in self.composed.items():
            if name == STEREO:
                raise ConfigError(f"composed.{name}: it is built in: give yours another name")
            if name not in self.cameras:
                raise ConfigError(f"composed.{name}: cameras does not name it: add it there")
            made.check(name, self.uplink_video.width, self.uplink_video.height)
            for part in made.compose:
                if self.composition(part) is not None:
                    raise ConfigError(
                        f"composed.{name}: {part} is composed itself: name cameras with sources"
                    )

    def _make_room(self) -> None:
        """Give both directions an insert zone for a sample of all axes."""
        if not self.more_axes:
            return
        octets = sample_octets(len(self.more_axes))
        for name in ("uplink", "downlink"):
            profile: LinkProfile = getattr(self, name)
            try:
                # A longer zone has no room for its pointer in the channel identifier.
                wider = replace(profile, insert_octets=octets, pointer_in_vcid=False)
            except ConfigError as error:
                raise ConfigError(
                    f"x, y, {', '.join(self.more_axes)}: a sample takes {octets} octets of each "
                    f"frame, {octets * 8} kbit/s in place of {SAMPLE_OCTETS * 8}: {error}"
                ) from None
            object.__setattr__(self, name, wider)

    def _take_pace(self) -> None:
        """Without force feedback, keep less room for samples, and use each for longer."""
        if not LEAST_PRESS_RATIO <= self.press_ratio <= MOST_PRESS_RATIO:
            raise ConfigError(
                f"press_ratio is {self.press_ratio:g}: take {LEAST_PRESS_RATIO:g} to "
                f"{MOST_PRESS_RATIO:g}"
            )
        if self.force == "felt":
            return
        if not LEAST_COMMAND_HZ <= self.command_hz <= MOST_COMMAND_HZ:
            raise ConfigError(
                f"command_hz is {self.command_hz}: take {LEAST_COMMAND_HZ} to {MOST_COMMAND_HZ}"
            )
        for name, value, only in (
            ("hand", self.hand, ("adaptive", "direct")),
            ("deadband", self.deadband, ("off",)),
            ("partner_arm", self.partner_arm, ("none",)),
        ):
            if value not in only:
                raise ConfigError(
                    f'{name} {value}: it is of a hand that feels; with force = "none" leave it out'
                )
        # Commands come down from space, the robot's state goes up.
        for name, rate_hz in (("uplink", FEEDBACK_HZ), ("downlink", self.command_hz)):
            profile = replace(getattr(self, name), sample_hz=rate_hz + OTHERS_HZ)
            object.__setattr__(self, name, profile)
        age_s = max(self.safety.command_max_age_s, lasts_ns(self.command_hz) / NS_PER_S)
        resume_s = max(self.safety.resume_within_s, age_s)
        safety = replace(self.safety, command_max_age_s=age_s, resume_within_s=resume_s)
        object.__setattr__(self, "safety", safety)

    @property
    def paced_hz(self) -> int | None:
        """The rate of commands without force feedback; None: with it."""
        return None if self.force == "felt" else self.command_hz

    def _take_repair(self) -> None:
        for name in ("uplink", "downlink"):
            profile: LinkProfile = getattr(self, name)
            fits = has_codes(profile)
            if self.repair == "idle" and not fits:
                raise ConfigError(
                    f"repair idle: {name} has no codes for it in frames of {profile.frame_octets} "
                    f'octets; take "auto" or "off"'
                )
            repair = self.repair if fits else "off"
            object.__setattr__(self, name, replace(profile, repair=repair))

    def _check_partner_arm(self) -> None:
        if self.partner_arm == "shared" and self.tasks:
            raise ConfigError(
                'partner_arm shared: tasks are the cosmonaut\'s, so take partner_arm = "none"'
            )
        if self.partner_arm != "none" and {*self.axes}.isdisjoint(("x", "y")):
            raise ConfigError("partner_arm: a partner's joystick has x and y: name them in axes")
        if self.partner_arm == "shared" and self.hand not in ("adaptive", "direct"):
            raise ConfigError(
                "partner_arm shared: only the joystick in space renders walls, so take "
                'hand = "direct", or partner_arm = "second"'
            )
        if self.partner_arm == "board" and (
            self.hand not in ("adaptive", "direct") or self.deadband != "off"
        ):
            raise ConfigError(
                "partner_arm board: a partner's robot tells no walls and leaves out no samples, "
                'so take hand = "direct" and deadband = "off"'
            )

    def _check_region(self) -> None:
        for camera, points in self.region_points.items():
            if camera not in self.cameras:
                raise ConfigError(
                    f"region_points of {camera}: setup {self.name} has no such camera: it has "
                    f"{', '.join(self.cameras)}"
                )
            with refused(f"region_points of {camera}", ConfigError):
                BoardView.from_corners(points)
        if self.region == "off" and self.region_points:
            raise ConfigError('region_points without a region: add region = "stylus"')

    def board_scene(self, camera: str) -> str | None:
        """The built-in scene of the task board that a camera shows; None if it shows none.

        That of `stereo` is its left half's: the board's plane is at the same pixels in both.
        """
        if camera in self.composed:
            return None
        inputs = self.inputs_of(camera)
        kinds, _, scenes = zip(*(self.source(name).partition(":") for name in inputs), strict=True)
        if set(kinds) != {"scene"} or (camera == STEREO and scenes != inputs):
            return None
        return scenes[0] if scenes[0] in _BOARD_SCENES else None

    @property
    def _named_radio(self) -> RadioProfile:
        return built_in_radio(self.radio) if isinstance(self.radio, str) else self.radio

    def radio_path(self, profile: LinkProfile, *, seed: int, epoch_ns: int) -> RadioPath:
        """The radio of one direction; `epoch_ns` is the instant of the profile's time 0."""
        up = profile is self.uplink
        return self.radio_profile.path("uplink" if up else "downlink", seed=seed, epoch_ns=epoch_ns)

    @property
    def camera_inputs(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(name for one in self.cameras for name in self.inputs_of(one)))

    def composition(self, camera: str) -> Composition | None:
        """How a camera is composed; None if it is an input."""
        return STEREO_PAIR if camera == STEREO else self.composed.get(camera)

    def inputs_of(self, camera: str) -> tuple[str, ...]:
        """The inputs that a camera shows."""
        made = self.composition(camera)
        return (camera,) if made is None else made.compose

    @property
    def inputs(self) -> tuple[str, ...]:
        """All inputs, cameras first."""
        return (
            *self.camera_inputs,
            *((GROUND_MIC,) if self.uplink_voice else ()),
            *((OPERATOR_CAMERA,) if self.downlink_video else ()),
            *((OPERATOR_MIC,) if self.downlink_voice else ()),
        )

    def kind_of(self, name: str) -> Literal["audio", "video"]:
        """Whether the input `name` is of sound or of pictures; ConfigError if it is unknown."""
        if name not in self.inputs:
            raise ConfigError(f"setup {self.name} has no input {name}")
        return "audio" if name in (GROUND_MIC, OPERATOR_MIC) else "video"

    def source(self, name: str) -> str:
        """The source of the input `name`; ConfigError when it has none."""
        spec = self.sources.get(name, DEFAULT_SCENES.get(name))
        if spec is None:
            raise ConfigError(
                f"input {name} has no built-in scene: give --source {name}=SPEC, "
                f'or {name} = "SPEC" in [sources] of the setup file'
            )
        return spec

    def stream_of(self, camera_input: str) -> VideoStream:
        """The stream whose size and rate the pictures of an input have."""
        if camera_input == OPERATOR_CAMERA and self.downlink_video is not None:
            return self.downlink_video
        return self.uplink_video

    def profile_of(self, stream: VideoStream | VoiceStream) -> LinkProfile:
        return self.profile(self.direction_of(stream))

    def profile(self, direction: Direction) -> LinkProfile:
        return self.uplink if direction is Direction.UPLINK else self.downlink

    def direction_of(self, stream: VideoStream | VoiceStream) -> Direction:
        """Which way a stream of this setup goes."""
        up = (self.uplink_video, self.uplink_voice)
        names = {each.name for each in up if each is not None}
        return Direction.UPLINK if stream.name in names else Direction.DOWNLINK

    def stale_after_ns(self, stream: VideoStream | VoiceStream) -> int:
        """The age (ns) above which what is shown or heard of `stream` is stale.

        A stream without its own value takes the radio's longest delay, 100 ms and four periods.
        """
        if stream.stale_after_ms is not None:
            return round(stream.stale_after_ms * NS_PER_MS)
        rate = stream.coded_hz if isinstance(stream, VideoStream) else VOICE_PACKETS_PER_S
        own_ns = _STALE_NS + round(_STALE_PERIODS * NS_PER_S / rate)
        return self.radio_profile.longest_delay_ns + own_ns

    @property
    def round_trip_ns(self) -> int:
        """The radio's longest delay (ns), there and back."""
        return 2 * self.radio_profile.longest_delay_ns

    @property
    def renders_walls(self) -> bool:
        """Whether the robot's side estimates walls, which the joystick's side renders."""
        felt = self.force == "felt"
        return felt and self.hand != "direct" and self.partner_arm not in ("shared", "board")

    @property
    def walls_from_ns(self) -> int:
        """The measured round trip (ns) from which on walls are told; 0: from the start."""
        near = self.hand == "adaptive" and self.round_trip_ns < WALLS_FROM_NS
        return WALLS_FROM_NS if near else 0

    @property
    def streams(self) -> tuple[VideoStream | VoiceStream, ...]:
        every = (self.uplink_video, self.uplink_voice, self.downlink_video, self.downlink_voice)
        return tuple(stream for stream in every if stream is not None)

    def need(self, direction: Direction) -> arithmetic.ChannelNeed:
        """What a direction carries with all streams at their caps; ConfigError if too much."""
        streams, reserve_bps = self._needs(direction)
        return arithmetic.check_fit(self.profile(direction), streams, reserve_bps=reserve_bps)

    def _needs(self, direction: Direction) -> tuple[list[arithmetic.StreamNeed], int]:
        """What the streams of a direction need, and what is kept beside them (bit/s)."""
        if direction is Direction.UPLINK:
            return [
                *_needs(self.uplink_voice, self.uplink_video),
                *self._walls,
            ], arithmetic.RESERVE_BPS
        return _needs(self.downlink_voice, self.downlink_video), arithmetic.RESERVE_DOWN_BPS

    @property
    def _walls(self) -> tuple[arithmetic.StreamNeed, ...]:
        """What the messages with walls need of the uplink."""
        if not self.renders_walls or self.walls_from_ns:
            return ()
        payload_bps = 8 * WALL_OCTETS * _WALLS_PER_S
        return (
            arithmetic.StreamNeed(
                name="walls", payload_bps=payload_bps, packets_per_s=_WALLS_PER_S, level=Level.TMTC
            ),
        )

    def freed_need_bps(self, stream: VideoStream, gain_bps: int) -> int:
        """The rate that left-out samples must free before `stream`'s cap can rise by `gain_bps`."""
        grown = replace(stream, cap_bps=stream.cap_bps + gain_bps)
        voice = self.uplink_voice if stream == self.uplink_video else self.downlink_voice
        walls = self._walls if stream == self.uplink_video else ()
        needs = [*_needs(voice, grown), *walls]
        return max(gain_bps, arithmetic.freed_need_bps(self.profile_of(stream), needs))

    def channel_table(self, direction: Direction) -> tuple[arithmetic.TableLine, ...]:
        """The arithmetic of `need`, line by line."""
        streams, reserve_bps = self._needs(direction)
        return arithmetic.channel_table(self.profile(direction), streams, reserve_bps=reserve_bps)


def _needs(*streams: VideoStream | VoiceStream | None) -> list[arithmetic.StreamNeed]:
    return [
        arithmetic.StreamNeed(
            name=stream.name,
            payload_bps=stream.cap_bps,
            packets_per_s=(
                stream.packets_per_s if isinstance(stream, VideoStream) else VOICE_PACKETS_PER_S
            ),
            level=Level.VIDEO if isinstance(stream, VideoStream) else Level.VOICE,
        )
        for stream in streams
        if stream is not None
    ]


def _check_camera(name: str) -> None:
    if not (1 <= len(name) <= MAX_CAMERA_OCTETS and name.isascii() and name.isprintable()):
        raise ConfigError(
            f"camera {name!r}: give it a name of 1 to {MAX_CAMERA_OCTETS} printable ASCII "
            "characters, so that a telecommand can carry it"
        )
