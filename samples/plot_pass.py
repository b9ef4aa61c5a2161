"""Watch a radio profile for ten minutes: elevation, delay, and what gets lost when.

Run it: python samples/plot_pass.py [--radio iss-pass] [--seed 1] [--seconds 600] [--picture x.png]
It prints a table by minute, for uplink and downlink, and draws a picture if told so.
"""

import argparse

import cv2
import numpy as np

from kontur_av.clock import NS_PER_MS
from telepresence.link.profile import DOWNLINK, UPLINK
from telepresence.link.radio import load_radio

BLUE, ORANGE, GREY, BLACK = (180, 110, 30), (30, 120, 230), (200, 200, 200), (40, 40, 40)
LEFT, WIDTH, HEIGHT, GAP = 80, 800, 150, 50


def watch(profile, link, seed, seconds):
    """One frame a millisecond: whether it arrived whole, and its delay in ms."""
    path = profile.path(link.name, seed=seed, epoch_ns=0)
    frame = bytes(link.frame_octets)
    whole = np.zeros(seconds * 1000, bool)
    delay_ms = np.zeros(seconds * 1000)
    spoiled = 0
    for slot in range(seconds * 1000):
        path.handle_frame(frame, slot * NS_PER_MS)
        path.poll_transmit(slot * NS_PER_MS)
        delay_ms[slot] = path.delay_ns / NS_PER_MS
        # A gateway drops a frame with a wrong bit, so both count as lost.
        whole[slot] = path.frames_lost + path.frames_hit == spoiled
        spoiled = path.frames_lost + path.frames_hit
    return whole, delay_ms


def longest_outage_s(whole):
    """The longest time without a whole frame, in s."""
    hits = np.flatnonzero(np.concatenate(([True], whole, [True])))
    return (np.diff(hits).max() - 1) / 1000


def panel(picture, row, title, top, seconds, curves):
    """One diagram: curves of (x in s, y from 0 to `top`, colour)."""
    bottom = (row + 1) * (HEIGHT + GAP)
    cv2.rectangle(picture, (LEFT, bottom - HEIGHT), (LEFT + WIDTH, bottom), GREY, 1)
    cv2.putText(picture, title, (LEFT, bottom - HEIGHT - 8), 0, 0.5, BLACK, 1, cv2.LINE_AA)
    for part in (0, 0.5, 1):
        at = (LEFT - 50, round(bottom - part * HEIGHT) + 5)
        cv2.putText(picture, f"{part * top:g}", at, 0, 0.45, BLACK, 1, cv2.LINE_AA)
    for minute in range(seconds // 60 + 1):
        x = LEFT + round(WIDTH * minute * 60 / seconds)
        cv2.line(picture, (x, bottom - HEIGHT), (x, bottom), GREY, 1)
        cv2.putText(picture, str(minute), (x - 4, bottom + 18), 0, 0.45, BLACK, 1, cv2.LINE_AA)
    for x, y, colour in curves:
        points = np.stack([LEFT + WIDTH * x / seconds, bottom - HEIGHT * np.clip(y / top, 0, 1)], 1)
        cv2.polylines(picture, [points.round().astype(np.int32)], False, colour, 1, cv2.LINE_AA)


def draw(path, seconds, elevations_deg, delay_ms, losses):
    picture = np.full((3 * (HEIGHT + GAP) + 40, LEFT + WIDTH + 30, 3), 255, np.uint8)
    second = np.arange(seconds)
    curves = []
    if elevations_deg:
        shown = np.array(elevations_deg[:seconds])
        curves = [(np.arange(len(shown)), shown, BLUE)]
    panel(picture, 0, "elevation, degrees over minutes", 90, seconds, curves)
    top = 10 * float(np.ceil(max(delay_ms.max(), 1) / 10))
    panel(picture, 1, "delay one way, ms", top, seconds, [(second, delay_ms[::1000], BLUE)])
    title = "frames lost in each second, %: uplink blue, downlink orange"
    curves = [(second, loss, colour) for loss, colour in zip(losses, (BLUE, ORANGE), strict=True)]
    panel(picture, 2, title, 100, seconds, curves)
    cv2.imwrite(path, picture)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--radio", default="iss-pass")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=int, default=600)
    parser.add_argument("--picture")
    args = parser.parse_args()

    profile = load_radio(args.radio)
    ways = [watch(profile, link, args.seed, args.seconds) for link in (UPLINK, DOWNLINK)]
    windows = profile.contact_windows()
    for name, value in (windows or {}).items():
        print(f"{name}: {value}")
    print("minute  delay ms     uplink lost %  longest s  downlink lost %  longest s")
    for begin in range(0, args.seconds * 1000, 60_000):
        part = slice(begin, begin + 60_000)
        delays = ways[0][1][part]
        row = f"{begin // 60_000:6}  {delays.min():5.1f}-{delays.max():5.1f}"
        for whole, _ in ways:
            lost = 100 * (1 - whole[part].mean())
            row += f"  {lost:13.3f}  {longest_outage_s(whole[part]):9.3f}"
        print(row)
    if args.picture:
        flight = profile.overflight()
        losses = [100 * (1 - whole.reshape(-1, 1000).mean(1)) for whole, _ in ways]
        draw(args.picture, args.seconds, flight and flight.elevations_deg, ways[0][1], losses)


if __name__ == "__main__":
    main()
