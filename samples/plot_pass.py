"""Run a radio profile for ten minutes: elevation, delay, and the frames lost in each minute.

Run it: python samples/plot_pass.py [--radio iss-pass] [--seed 1] [--seconds 600] [--picture x.png]
It prints a table by minute, for uplink and downlink. `--picture` also draws a chart, with
matplotlib: pip install 'kontur-av[bench]'.
"""

import argparse
from dataclasses import asdict

import numpy as np

from kontur_av import ConfigError
from kontur_av.clock import NS_PER_MS
from telepresence import DOWNLINK, UPLINK, load_radio


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


def draw(path, seconds, elevations_deg, delay_ms, losses):
    """Elevation, delay and losses over the minutes of the pass, one below the other."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 6), dpi=150, layout="constrained")
    above, middle, below = figure.subplots(3, sharex=True)
    minutes = np.arange(seconds) / 60
    if elevations_deg:
        shown = elevations_deg[:seconds]
        above.plot(minutes[: len(shown)], shown)
    middle.plot(minutes, delay_ms[::1000])
    for label, loss, width in zip(("uplink", "downlink"), losses, (2, 0.8), strict=True):
        below.plot(minutes, loss, label=label, linewidth=width)
    below.legend(loc="upper center", fontsize="small")
    below.set_xlabel("time, min")
    below.set_xlim(0, seconds / 60)
    for axes, unit, top in (
        (above, "elevation, degrees", 90),
        (middle, "one-way delay, ms", 1.1 * max(delay_ms.max(), 1)),
        (below, "frames lost, %, by second", 105),
    ):
        axes.set_ylabel(unit, fontsize="small")
        axes.set_ylim(0, top)
        axes.grid(alpha=0.4)
    figure.savefig(path)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--radio", default="iss-pass")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=int, default=600)
    parser.add_argument("--picture")
    args = parser.parse_args()

    try:
        profile = load_radio(args.radio)
    except ConfigError as error:
        parser.exit(2, f"{error}\n")
    ways = [watch(profile, link, args.seed, args.seconds) for link in (UPLINK, DOWNLINK)]
    windows = profile.contact_windows()
    for name, value in ({} if windows is None else asdict(windows)).items():
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
