"""Each contact in a recording: the robot's force, and how old the operator's picture was.

Run it: python samples/plot_contacts.py FILE.mcap [FILE-2.mcap ...] [--picture x.png]
It prints a line for each contact. `--picture` also draws force and latency around each of them,
with matplotlib: pip install 'kontur-av[bench]'. It needs nothing of this project: the package mcap
reads the file, and the file itself says how its messages are built. Fix a torn file before, with
`kontur-av recover`.
"""

import argparse
from pathlib import Path

import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.exceptions import McapError
from mcap.reader import make_reader

ROBOT, PICTURES = "/haptic/up/sent", "/uplink_video/received/facts"
CONTACT = 1  # bit 0 of `flags`
BEFORE_S, AFTER_S, STEP_S = 0.5, 1.0, 0.1


def message_class(schema):
    """The class of a channel's messages, built from the schema in the file."""
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
        pool.AddSerializedFile(file.SerializeToString())
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))


def read(paths):
    """The robot's cycles (s, N, contact), and the pictures (s, latency in ms), in wall time."""
    cycles, pictures = [], []
    for path in paths:
        with path.open("rb") as file:
            reader = make_reader(file)
            capabilities = next(
                one.metadata for one in reader.iter_metadata() if one.name == "kontur-av"
            )
            to_wall_ns = int(capabilities["wall_ns"]) - int(capabilities["session_ns"])
            classes = {}
            for schema, channel, message in reader.iter_messages([ROBOT, PICTURES]):
                if schema.id not in classes:
                    classes[schema.id] = message_class(schema)
                block = classes[schema.id].FromString(message.data)
                if channel.topic == PICTURES:
                    if block.dated and not block.refused and not block.added:
                        # From the instant of capture until the picture was there, decoded.
                        late_ns = message.publish_time - message.log_time
                        pictures.append((message.log_time / 1e9, late_ns / 1e6))
                    continue
                force_n = np.hypot(block.fx_n, block.fy_n)
                touches = np.array(block.flags, np.uint32) & CONTACT
                wall_s = (np.array(block.time_ns) + to_wall_ns) / 1e9
                cycles.append(np.stack((wall_s, force_n, touches)))
    robot = np.concatenate(cycles, axis=1) if cycles else np.zeros((3, 0))
    return robot, np.array(pictures).reshape(-1, 2).T


def contacts(robot):
    """When each contact began and ended, as rows of two indices."""
    touches = robot[2] > 0
    return np.flatnonzero(np.diff(np.concatenate(([0], touches, [0])))).reshape(-1, 2)


def around(rows, instant_s):
    """The columns within the window around an instant, their times relative to it."""
    time_s = rows[0] - instant_s
    near = (time_s >= -BEFORE_S) & (time_s <= AFTER_S)
    return time_s[near], rows[1][near]


def draw_median(axes, found):
    """The median of all points in steps of `STEP_S`. found: times and values."""
    edges = np.arange(-BEFORE_S, AFTER_S + STEP_S / 2, STEP_S)
    steps = [found[1][(found[0] >= edge) & (found[0] < edge + STEP_S)] for edge in edges[:-1]]
    medians = [np.median(step) if len(step) else np.nan for step in steps]
    axes.stairs(medians, edges, baseline=None, color="black", linewidth=2, label="median")
    axes.legend(fontsize="small")


def draw(path, robot, pictures, begins):
    """Force above, latency of the pictures below, all contacts on top of each other."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 6), dpi=150, layout="constrained")
    above, below = figure.subplots(2, sharex=True)
    for number, begin_s in enumerate(begins, start=1):
        above.plot(*around(robot, begin_s), alpha=0.7, label=f"contact {number}")
        below.plot(*around(pictures, begin_s), ".", alpha=0.7)
    draw_median(below, np.concatenate([around(pictures, each) for each in begins], axis=1))
    above.set_ylabel("force of the board, N")
    below.set_ylabel("capture to operator, ms")
    below.set_xlabel("time since the contact began, s")
    below.set_xlim(-BEFORE_S, AFTER_S)
    if len(begins) <= 10:
        above.legend(fontsize="small")
    for axes in (above, below):
        axes.axvline(0, color="black", linewidth=0.8)
        axes.set_ylim(bottom=0)
        axes.grid(alpha=0.4)
    figure.savefig(path)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("files", nargs="+", type=Path, metavar="FILE.mcap")
    parser.add_argument("--picture")
    args = parser.parse_args()

    try:
        robot, pictures = read(args.files)
    except (OSError, McapError, StopIteration) as error:
        parser.exit(
            2, f"{args.files[0]} is no whole recording: {error or 'no capabilities in it'}\n"
        )
    found = contacts(robot)
    if not len(found):
        parser.exit(1, "the robot touched nothing\n")
    print("contact  at s     for s  most force N  picture ms")
    for number, (first, behind) in enumerate(found, start=1):
        begin_s, end_s = robot[0, first], robot[0, behind - 1]
        late_ms = around(pictures, begin_s)[1]
        late = f"{np.median(late_ms):10.1f}" if len(late_ms) else "         –"
        most_n = robot[1, first:behind].max()
        at_s = begin_s - robot[0, 0]
        print(f"{number:7}  {at_s:6.2f}  {end_s - begin_s:6.3f}  {most_n:12.2f}  {late}")
    if args.picture:
        draw(args.picture, robot, pictures, robot[0, found[:, 0]])


if __name__ == "__main__":
    main()
