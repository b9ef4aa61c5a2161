"""What a hand feels of a wall, by round trip: force over penetration, direct and mediated.

Run it: python samples/mediated_wall.py [--delays 0,20,60,300,800] [--picture felt.png]
It prints a table for a soft and a firm grip, on virtual time. `--picture` also draws it, with
matplotlib: pip install 'kontur-av[bench]'.
"""

import argparse
from collections import deque

import numpy as np

from kontur_av.clock import NS_PER_MS
from telepresence import (
    FIRM_GRIP,
    SOFT_GRIP,
    WALL_X_M,
    Hand,
    HeldJoystick,
    JoystickSide,
    RobotSide,
    Waypoint,
)

#: Presses on the wall for 2.5 s of every 4 s.
PRESS = (
    Waypoint(0.04, 0.0, 300 * NS_PER_MS, 700 * NS_PER_MS),
    Waypoint(0.085, 0.0, 500 * NS_PER_MS, 2500 * NS_PER_MS),
)


def touch(grip, round_trip_ms, *, mediated, presses=4):
    """Rows of each press, one a millisecond: penetration of the handle (m), force on it (N)."""
    handle = HeldJoystick(hand=Hand(grip, script=PRESS))
    space, ground = JoystickSide(handle=handle, mediated=mediated), RobotSide(mediated=mediated)
    down, up, walls = deque(), deque(), deque()
    rows = np.empty((presses * 4000, 2))
    for ms in range(len(rows)):
        now_ns = ms * NS_PER_MS
        while down and down[0][0] <= now_ns:
            ground.handle_datagram(down.popleft()[1], now_ns)
        while up and up[0][0] <= now_ns:
            space.handle_datagram(up.popleft()[1], now_ns)
        while walls and walls[0][0] <= now_ns:
            space.handle_wall(walls.popleft()[1])
        ground.handle_cycle(now_ns, NS_PER_MS)
        space.handle_cycle(now_ns, NS_PER_MS)
        due_ns = now_ns + round_trip_ms * NS_PER_MS // 2
        for path, out in (
            (down, space.poll_transmit(now_ns)),
            (up, ground.poll_transmit(now_ns)),
            (walls, ground.poll_wall(now_ns)),
        ):
            if out is not None:
                path.append((due_ns, out))
        rows[ms] = handle.x_m - WALL_X_M, -handle.motor_x_n
    return rows.reshape(presses, 4000, 2)


def felt(presses):
    """Force over penetration (N/m) when the first and the last press end, and the swing (N)."""
    ends = presses[:, -500:]
    depth_m, force_n = ends[:, :, 0].mean(axis=1), ends[:, :, 1].mean(axis=1)
    return force_n[0] / depth_m[0], force_n[-1] / depth_m[-1], np.ptp(ends[-1, :, 1])


def draw(picture, delays, found):
    """Draw the last press by delay."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.subplots()
    for (name, mediated), rows in found.items():
        style = "o-" if mediated else "x--"
        axes.plot(delays, [last for _, last, _ in rows], style, label=f"{name}, {_way(mediated)}")
    axes.set(xlabel="round trip (ms)", ylabel="force over penetration (N/m)", ylim=(0, 700))
    axes.legend()
    figure.savefig(picture, dpi=100)


def _way(mediated):
    return "mediated" if mediated else "direct"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--delays", default="0,20,60,300,800", help="round trips in ms")
    parser.add_argument("--picture", help="draw a chart into this PNG file")
    args = parser.parse_args()
    delays = [int(delay) for delay in args.delays.split(",")]
    found = {}
    print(f"{'round trip':>10} {'grip':>5} {'hand':>9} {'first':>9} {'last':>9} {'swing':>8}")
    for delay in delays:
        for name, grip in (("soft", SOFT_GRIP), ("firm", FIRM_GRIP)):
            for mediated in (False, True):
                row = felt(touch(grip, delay, mediated=mediated))
                found.setdefault((name, mediated), []).append(row)
                first, last, swing = row
                print(
                    f"{delay:7d} ms {name:>5} {_way(mediated):>9} {first:5.0f} N/m {last:5.0f} N/m"
                    f" {swing:6.2f} N"
                )
    if args.picture:
        draw(args.picture, delays, found)


if __name__ == "__main__":
    main()
