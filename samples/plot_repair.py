"""Pictures that come over lost frames: without repair, with it, and GStreamer's FEC beside it.

Run it: python samples/plot_repair.py [--seconds 60] [--loss 0.01 0.05] [--picture x.png]
Ours are sessions of `spacejustin` on virtual time, 30 ms one way: the share of the coded pictures
that was shown. GStreamer (x264enc, rtph264pay, rtpulpfecenc) codes clip.mp4 for the same octets;
a packet is lost with any of the link's frames that it would lie in, and a FEC packet (RFC 5109)
restores one. Its curve is the share of pictures that are whole, with the percentage of FEC that is
best at each loss. Without GStreamer it is left out. `--picture` draws a chart, with matplotlib: pip
install 'kontur-av[bench]'.
"""

import argparse
import shutil
import subprocess
import tempfile
from dataclasses import replace
from itertools import count
from pathlib import Path
from random import Random

import av

from pipelines import load_setup, simulate
from telepresence import load_radio

CLIP = Path(__file__).with_name("clip.mp4")
LOSSES = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1)
OURS = {"off": "without repair", "idle": "idle slots alone", "auto": "auto"}
#: Octets of a frame for pictures and voice; what video, its headers and its repair take of them.
ZONE_OCTETS, FOR_VIDEO_KBPS = 12, 87
#: GStreamer's percentages of FEC.
PERCENTAGES = (0, 20, 50, 100)
MEDIA, FEC = 96, 122
WIDTH, HEIGHT, FPS = 384, 288, 30


def ours(loss, repair, seconds):
    """The share of the uplink's coded pictures that were shown."""
    radio = replace(load_radio("cable"), name="lossy", delay_ms=30.0, frame_loss=loss)
    setup = load_setup("spacejustin", changes={"radio": radio, "repair": repair})
    stream = simulate(setup, seconds=seconds, seed=404).streams["uplink_video"]
    return stream.display.frames_displayed / stream.sender.frames_encoded


def film(path, seconds):
    """Write the clip again and again, as raw I420."""
    left = seconds * FPS
    with path.open("wb") as file:
        while left:
            with av.open(str(CLIP)) as clip:
                for _, picture in zip(range(left), clip.decode(video=0), strict=False):
                    scaled = picture.reformat(WIDTH, HEIGHT, "yuv420p")
                    file.write(scaled.to_ndarray().tobytes())
                    left -= 1


def packets(raw, percentage):
    """The RTP packets of GStreamer's sender, media and FEC."""
    # 12 octets of RTP a picture, and as many, with 14 more, for each FEC packet.
    headers_kbps = 12 * 8 * FPS / 1000 * (1 + 2.2 * percentage / 100)
    bitrate = round((FOR_VIDEO_KBPS - headers_kbps) / (1 + percentage / 100))
    into = Path(f"{raw}.{percentage}")
    into.mkdir()
    command = f"""gst-launch-1.0 -q filesrc location={raw} !
        rawvideoparse width={WIDTH} height={HEIGHT} format=i420 framerate={FPS}/1 !
        x264enc tune=zerolatency speed-preset=veryfast bitrate={bitrate} vbv-buf-capacity=40
        aud=false intra-refresh=true key-int-max={2 * FPS} ! rtph264pay pt={MEDIA} mtu=1200
        aggregate-mode=zero-latency !
        rtpulpfecenc pt={FEC} percentage={percentage} multipacket=true !
        multifilesink location={into}/%08d next-file=buffer"""
    subprocess.run(command.split(), check=True)
    return [each.read_bytes() for each in sorted(into.iterdir())]


def protected(packet):
    """The sequence numbers that a FEC packet protects (RFC 5109 section 7)."""
    base = int.from_bytes(packet[14:16], "big")
    long = packet[12] & 0x40
    mask = int.from_bytes(packet[24 : 30 if long else 26], "big")
    bits = 48 if long else 16
    return [base + n & 0xFFFF for n in range(bits) if mask >> (bits - 1 - n) & 1]


def whole(sent, loss):
    """The share of pictures of which every packet comes or is restored."""
    random = Random(404)
    lost, pictures, groups = set(), {}, []
    for packet in sent:
        frames = -(-len(packet) // ZONE_OCTETS)
        gone = random.random() > (1 - loss) ** frames
        sequence = int.from_bytes(packet[2:4], "big")
        if packet[1] & 0x7F == MEDIA:
            pictures.setdefault(packet[4:8], []).append(sequence)
            lost |= {sequence} if gone else set()
        elif not gone:
            groups.append(protected(packet))
    for _ in count():
        restored = {
            missing[0]
            for group in groups
            if len(missing := [sequence for sequence in group if sequence in lost]) == 1
        }
        if not restored:
            break
        lost -= restored
    return sum(lost.isdisjoint(each) for each in pictures.values()) / len(pictures)


def draw(path, losses, curves):
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 4), dpi=150, layout="constrained")
    axes = figure.subplots()
    for name, shares in curves.items():
        axes.semilogx(
            [100 * loss for loss in losses],
            [100 * share for share in shares],
            label=name,
            marker="o",
        )
    axes.set_xlabel("lost frames, %")
    axes.set_ylabel("pictures that come, %")
    axes.set_xticks([100 * loss for loss in losses], [f"{100 * loss:g}" for loss in losses])
    axes.set_ylim(0, 102)
    axes.grid(alpha=0.4)
    axes.legend(loc="lower left")
    figure.savefig(path)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=int, default=60)
    parser.add_argument("--loss", type=float, nargs="+", default=LOSSES)
    parser.add_argument("--picture")
    args = parser.parse_args()
    curves = {
        name: [ours(loss, repair, args.seconds) for loss in args.loss]
        for repair, name in OURS.items()
    }
    if shutil.which("gst-launch-1.0"):
        with tempfile.TemporaryDirectory() as directory:
            raw = Path(directory) / "film.yuv"
            film(raw, args.seconds)
            sent = [packets(raw, percentage) for percentage in PERCENTAGES]
        for each, percentage in zip(sent, PERCENTAGES, strict=True):
            rate = sum(map(len, each)) * 8 / args.seconds / 1000
            print(f"GStreamer, {percentage} % of FEC: {len(each)} packets, {rate:.1f} kbit/s")
        curves["GStreamer, rtpulpfecenc"] = [
            max(whole(each, loss) for each in sent) for loss in args.loss
        ]
    for name, shares in curves.items():
        print(f"{name:24}", *(f"{100 * share:5.1f}" for share in shares))
    if args.picture:
        draw(args.picture, args.loss, curves)


if __name__ == "__main__":
    main()
