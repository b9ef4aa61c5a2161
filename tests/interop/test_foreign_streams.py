"""HEVC of others, joined late and with losses: open groups of pictures (CRA, RASL, RADL).

Invariant: a picture that shows no loss is the one that FFmpeg decodes from the whole stream.
"""

import hashlib
import random
import struct
import subprocess

import av
import pytest
from programs import needs

from kontur_av.codecs.decoder import VideoDecoder
from kontur_av.media import Quality
from kontur_av.rtp.annex_b import split_annex_b
from kontur_av.rtp.nal_formats import H265, RASL
from kontur_av.streams.video_receiver import VideoReceiver

pytestmark = pytest.mark.interop

HERE = ("192.0.2.1", 5004)
PERIOD_NS = 40_000_000
GROUP = "log-level=none:ctu=32:b-adapt=0:keyint=12:min-keyint=12:scenecut=0:repeat-headers=1"
STREAMS = {
    "open": f"{GROUP}:open-gop=1:bframes=4",
    "slices": f"{GROUP}:open-gop=1:bframes=3:slices=4",
    "radl": f"{GROUP}:open-gop=0:radl=2:bframes=3",
}
GSTREAMER = (
    "videotestsrc pattern=ball num-buffers=72 ! "
    "video/x-raw,width=192,height=160,framerate=25/1,format=I420 ! x265enc speed-preset=veryfast "
    "key-int-max=12 option-string=open-gop=1:bframes=4:b-adapt=0:keyint=12:min-keyint=12 ! "
    "h265parse config-interval=-1 ! mpegtsmux ! filesink location="
)


def digest(array):
    return hashlib.md5(array.tobytes()).digest()


def packed(payload, sequence, time, marker, ssrc):
    return struct.pack("!BBHII", 0x80, 96 | marker << 7, sequence & 0xFFFF, time, ssrc) + payload


@pytest.fixture(scope="module", params=[*STREAMS, "gstreamer"])
def stream(request, tmp_path_factory):
    """Return access units with their times, and FFmpeg's pictures of the whole stream by time."""
    tool = "gst-launch-1.0" if request.param == "gstreamer" else "ffmpeg"
    needs(tool)
    path = tmp_path_factory.mktemp("film") / "film.ts"
    if request.param == "gstreamer":
        command = [tool, "-q", *GSTREAMER.split()]
        command[-1] += str(path)
    else:
        source = "testsrc2=s=192x160:r=25:d=3,noise=alls=8:allf=t"
        command = [*f"{tool} -v error -f lavfi -i {source} -pix_fmt yuv420p".split(), "-c:v"]
        command += ["libx265", "-preset", "veryfast", "-x265-params", STREAMS[request.param], path]
    subprocess.run(command, check=True, timeout=300)
    with av.open(str(path)) as container:
        units = [(one.pts, bytes(one)) for one in container.demux(video=0) if one.size]
    decoder, pictures = VideoDecoder("h265", reordered=True), {}
    for time, data in units:
        pictures.update(
            (one.timestamp, digest(one.to_i420())) for one in decoder.decode(data, time)
        )
    pictures.update((one.timestamp, digest(one.to_i420())) for one in decoder.drain())
    assert len(pictures) == len(units) >= 70
    return units, pictures


def received(units, lost, begin=0):
    """Return the receiver, and by time whether the picture is fresh, and its digest."""
    receiver, decoder = VideoReceiver(ssrc=1, codec="h265"), VideoDecoder("h265", reordered=True)
    found, sequence = {}, 0

    def show(pictures):
        for picture in pictures:
            stamp = receiver.handle_picture(
                picture.timestamp, picture.width, picture.height, 0, corrupt=picture.corrupt
            )
            fresh = stamp is not None and stamp.quality is Quality.FRESH
            found[picture.timestamp] = fresh, digest(picture.to_i420())

    def take():
        while (unit := receiver.next_event()) is not None:
            corrupt = decoder.counts.frames_corrupt
            pictures = decoder.decode(unit.data, unit.timestamp)
            if decoder.counts.frames_corrupt > corrupt:
                receiver.handle_undecoded()
            show(pictures)

    for number, (time, data) in enumerate(units):
        payloads = H265.packetize(split_annex_b(data), 400)
        for payload in payloads:
            marker = payload is payloads[-1]
            packet = packed(payload, sequence, time, marker, 7)
            sequence += 1
            if number >= begin and not lost(number):
                receiver.handle_packet(packet, number * PERIOD_NS, HERE)
        receiver.handle_timeout(number * PERIOD_NS + 1)
        take()
    receiver.handle_timeout(10**13)
    take()
    show(decoder.drain())
    return receiver, found


def test_without_losses_every_picture_comes(stream):
    units, expected = stream
    receiver, found = received(units, lambda number: False)
    assert found == {time: (True, picture) for time, picture in expected.items()}
    assert receiver.counts.frames_without_references == 0


@pytest.mark.parametrize("begin", [1, 12, 15])
def test_who_joins_late_sees_whole_pictures_from_the_next_key_picture_on(stream, begin):
    units, expected = stream
    kinds = [{H265.nal_type(nal) for nal in split_annex_b(data)} for _, data in units]
    key = next(at for at in range(begin, len(units)) if not H265.keys.isdisjoint(kinds[at]))
    later = next(
        (at for at in range(key + 1, len(units)) if not H265.keys.isdisjoint(kinds[at])), len(units)
    )
    skipped = {at for at in range(begin, later) if not RASL.isdisjoint(kinds[at])}
    receiver, found = received(units, lambda number: False, begin)
    due = {units[at][0] for at in range(key, len(units)) if at not in skipped}
    assert found == {time: (True, expected[time]) for time in due}
    assert receiver.counts.frames_without_references == len(skipped)


@pytest.mark.parametrize("seed", range(3))
def test_after_losses_no_picture_that_shows_damage_is_called_fresh(stream, seed):
    units, expected = stream
    draw = random.Random(seed)
    _, found = received(units, lambda number: draw.random() < 0.02)
    assert {time: picture for time, (fresh, picture) in found.items() if fresh}.items() <= (
        expected.items()
    )
    # Groups of pictures that nothing of is lost come whole.
    assert sum(fresh for fresh, _ in found.values()) >= 5
