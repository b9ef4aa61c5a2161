"""What many viewers cost a sender whose picture Janus hands on.

    python tests/viewers.py [--viewers 20] [--seconds 10]

prints the CPU time of `kontur-av publish` and of Janus, with one viewer and with many. Viewers run
in this process, so give it a machine with a core to spare.
"""

import argparse
import asyncio
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "helpers"))

from janus_room import Audience, cpu_s, missing


async def measure(counts, seconds):
    """(viewers, CPU of sender and Janus in %, pictures a second of the worst viewer) of each."""
    found = []
    with tempfile.TemporaryDirectory() as folder:
        async with Audience(Path(folder), "--video", "scene:static") as audience:
            for count in counts:
                await audience.add_viewers(count - len(audience.viewers))
                # Their first pictures are key pictures, which cost more.
                await asyncio.sleep(2)
                pids = audience.sender.pid, audience.janus.process.pid
                before = [cpu_s(pid) for pid in pids]
                seen = [viewer.pictures for viewer in audience.viewers]
                began_s = asyncio.get_running_loop().time()
                await asyncio.sleep(seconds)
                took_s = asyncio.get_running_loop().time() - began_s
                shares = [
                    100 * (cpu_s(pid) - cpu) / took_s for pid, cpu in zip(pids, before, strict=True)
                ]
                shown = [
                    (viewer.pictures - pictures) / took_s
                    for viewer, pictures in zip(audience.viewers, seen, strict=True)
                ]
                found.append((count, *shares, min(shown)))
    return found


def main():
    parser = argparse.ArgumentParser(description="what many viewers cost a sender")
    parser.add_argument("--viewers", type=int, default=20)
    parser.add_argument("--seconds", type=float, default=10.0)
    args = parser.parse_args()
    if missing():
        sys.exit(f"needs {missing()}")
    print("| viewers | sender, % of a core | Janus, % of a core | pictures/s, worst viewer |")
    print("|--:|--:|--:|--:|")
    for count, sender, janus, shown in asyncio.run(measure([1, args.viewers], args.seconds)):
        print(f"| {count} | {sender:.1f} | {janus:.1f} | {shown:.1f} |")


if __name__ == "__main__":
    main()
