"""Read what the operator's display shows, while a session runs on this machine.

kontur-av stream --setup spacejustin &
python samples/watch_operator.py [SESSION]          without a name: the only one that runs
"""

import sys

import cv2

from kontur_av.clock import NS_PER_MS, NS_PER_S, MonotonicClock
from kontur_av.errors import ConfigError
from kontur_av.topics.bus import TopicBus


def watch(session: str | None, pictures: int = 100) -> None:
    clock = MonotonicClock()
    with TopicBus.join(session) as bus:
        reader = bus.reader("displayed/uplink_video")
        for _ in range(pictures):
            # Wait for a picture, take the newest, and give it back after use: nothing is copied.
            if reader.wait(NS_PER_S) and (lease := reader.latest()):
                with lease:
                    frame = lease.video()
                    rgb = cv2.cvtColor(frame.data, cv2.COLOR_YUV2RGB_I420)  # (height, width, 3)
                    age_ms = (clock.now_ns() - frame.stamp.capture_ns) / NS_PER_MS
                    print(f"{frame.stamp.source}: {rgb.shape}, {age_ms:.0f} ms old")


if __name__ == "__main__":
    try:
        watch(sys.argv[1] if len(sys.argv) > 1 else None)
    except ConfigError as error:
        raise SystemExit(f"watch_operator: {error}") from None
