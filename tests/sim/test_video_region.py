"""With a region around the stylus its tip is sharper, the rest hardly coarser, and nothing late.

`pytest -s tests/sim/test_video_region.py` prints the figures of docs/experiments/video.md.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from virtual_scene import bare_scene

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.codecs.h26x import H264Decoder
from kontur_av.media import CaptureStamp, VideoFrame, empty_picture, planes
from kontur_av.rtp.sender import RtpIdentity
from kontur_av.sources.stereo import StereoPair, merge
from pipelines.media.following import CameraFollower, Choice, tip_region
from pipelines.media.stream_figures import video_sender
from pipelines.report.model import CodingCosts
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.virtual.streams import VideoSendProcess
from pipelines.virtual.studio import Paired, Shot, VideoStudio
from pipelines.virtual.workers import Agenda, Job
from telepresence.world import scripted_state
from telepresence.world.ground_views import camera_of

SETUP = BUILT_IN["spacejustin"]
STREAM = SETUP.uplink_video
#: What the uplink has for pictures, and the time from the last octet to the screen.
CHANNEL_BPS, SHOWING_NS = 88_000, 3 * NS_PER_MS
SECONDS, SETTLED_S = 12, 1
HALF_PX = 48


def picture_of(shots, stamp):
    """A picture for the coder: of one camera, or of both."""
    if len(shots) == 1:
        return shots[0]
    left, right = (VideoFrame(shot, stamp) for shot in shots)
    return Paired(StereoPair(left, right, stamp, left_stale=False, right_stale=False), 0)


def shots_of(picture):
    if isinstance(picture, Shot):
        return (picture,)
    return picture.pair.left.data, picture.pair.right.data


class Studio:
    """Draws and encodes at once, and compares what a receiver would show."""

    def __init__(self, camera, setup):
        self.view = "left" if camera == "stereo" else camera
        names = ("left", "right") if camera == "stereo" else (camera,)
        cameras = {name: f"scene:{name}" for name in names}
        self.studio = VideoStudio(STREAM, cameras, 0, regions=setup.region != "off")
        self.decoder = H264Decoder()
        self.camera = camera_of(self.view, STREAM.width, STREAM.height)
        self.states, self.octets, self.tip_db, self.rest_db = [], [], [], []

    def submit(self, job):
        picture, _, _ = job
        shots = shots_of(picture)
        for shot in shots:
            self.studio(shot)
        data, keyframe = self.studio(job)
        self.states.append(shots[0].state)
        self.octets.append(len(data))
        self.compare(shots, data)
        done = Job(None)
        done.set((data, keyframe))
        return done

    def compare(self, shots, data):
        drawn = [self.studio._ahead[shot.camera][1] for shot in shots]
        original, shown = drawn[0], empty_picture(STREAM.width, STREAM.height)
        if len(drawn) == 2:
            original = empty_picture(STREAM.width, STREAM.height)
            merge(*drawn, original)
        (decoded,) = self.decoder.decode(data, len(self.octets))
        decoded.scale_into(shown)
        error = (planes(shown)[0].astype(np.float32) - planes(original)[0]) ** 2
        state = shots[0].state
        ((x, y),) = np.rint(self.camera.project(np.array([(state.x_m, state.y_m, 0.0)]))).astype(
            int
        )
        around = error[max(y - HALF_PX, 0) : y + HALF_PX, max(x - HALF_PX, 0) : x + HALF_PX]
        whole, tip = (part.sum(dtype=np.float64) for part in (error, around))
        rest = (whole - tip) / (error.size - around.size)
        for values, mean in ((self.tip_db, tip / around.size), (self.rest_db, rest)):
            values.append(10 * np.log10(255**2 / max(mean, 1e-3)))


class Channel:
    """Carries one octet after the other. arrived_ns: arrival of the last one of each picture."""

    freed_bps, contacts = 0, 1
    supervisor = SimpleNamespace(signal=True)
    sender = SimpleNamespace(waiting_octets=lambda level: 0)

    def __init__(self):
        self.free_ns = 0
        self.arrived_ns = []

    def handle_datagram(self, flow, packet, now_ns):
        self.free_ns = max(self.free_ns, now_ns) + len(packet) * 8 * NS_PER_S // CHANNEL_BPS
        if flow == STREAM.name and packet[1] & 0x80:
            self.arrived_ns.append(self.free_ns)


def run(camera, region):
    """Return mean and worst-5-% PSNR of the tip and of the rest in dB, p99 in ms, and kbit/s."""
    setup = replace(SETUP, region=region)
    studio, channel, agenda = Studio(camera, setup), Channel(), Agenda()
    core = video_sender(setup, STREAM, RtpIdentity(1, 2, 3), wall_offset_ns=0)
    scene = bare_scene(agenda, setup, CodingCosts())
    sender = VideoSendProcess(scene, STREAM, core, channel, studio)
    sender.follower = CameraFollower()
    sender.handle_choice(Choice(1, camera), 0)
    tip = tip_region(setup)
    sender.tip = None if tip is None else (tip, scripted_state)
    names = ("left", "right") if camera == "stereo" else (camera,)

    def come(number, instant_ns):
        state = scripted_state(instant_ns)
        stamp = CaptureStamp(instant_ns, number, "test")
        picture = picture_of([Shot(name, number, state) for name in names], stamp)
        return lambda now_ns: sender.handle_picture(picture, stamp, now_ns)

    for number in range(SECONDS * STREAM.fps):
        instant_ns = number * NS_PER_S // STREAM.fps
        agenda.at(instant_ns + NS_PER_MS, come(number, instant_ns))
    while agenda.next_ns < (SECONDS + 1) * NS_PER_S:
        agenda.do_next()
    first = SETTLED_S * STREAM.fps
    pairs = list(zip(studio.states, channel.arrived_ns, strict=True))[first:]
    late_ms = [(at_ns + SHOWING_NS - state.time_ns) / NS_PER_MS for state, at_ns in pairs]
    tip_db, rest_db = np.array(studio.tip_db[first:]), np.array(studio.rest_db[first:])
    found = SimpleNamespace(
        tip=tip_db.mean(),
        tip_worst=np.sort(tip_db)[: len(tip_db) // 20].mean(),
        rest=rest_db.mean(),
        rest_worst=np.sort(rest_db)[: len(rest_db) // 20].mean(),
        p50=np.percentile(late_ms, 50),
        p99=np.percentile(late_ms, 99),
        shown=len(late_ms) / (SECONDS - SETTLED_S),
        kbps=sum(studio.octets[first:]) * 8 / (SECONDS - SETTLED_S) / 1000,
    )
    print(
        f"\n| {camera} | {region} | {found.tip:.1f}/{found.tip_worst:.1f} "
        f"| {found.rest:.1f}/{found.rest_worst:.1f} | {found.p50:.0f} | {found.p99:.0f} "
        f"| {found.shown:.1f} | {found.kbps:.0f} |"
    )
    return found


@pytest.mark.parametrize("camera", ["stereo", "static"])
def test_the_tip_is_sharper_and_nothing_is_late(camera):
    without, with_region = run(camera, "off"), run(camera, "stylus")
    assert with_region.tip > without.tip + 0.3
    assert with_region.rest > without.rest - 0.5
    assert with_region.p99 < without.p99 + 3
    assert with_region.kbps <= STREAM.cap_bps / 1000
