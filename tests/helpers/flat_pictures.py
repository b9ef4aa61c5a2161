"""Pictures of one colour for the camera that a page may take over, and what comes of them."""

import threading
from contextlib import contextmanager

from running_part import SETUP

from kontur_av.media import empty_picture

STREAM = SETUP.downlink_video
#: What a page in space films, and its pictures' size.
PAGE = "page/iss_camera"
PICTURE_OCTETS = STREAM.width * STREAM.height * 3 // 2


def flat(level, width=STREAM.width, height=STREAM.height):
    picture = empty_picture(width, height)
    picture[:height], picture[height:] = level, 128
    return picture


@contextmanager
def repeated(act, period_s=0.033):
    """Call `act(number)` again and again in a thread."""
    over = threading.Event()

    def run():
        number = 0
        while not over.wait(period_s):
            act(number)
            number += 1

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def newest_level(reader):
    """The mean luma of the newest picture if it is flat, else -1; None if there is no new one."""
    lease = reader.latest()
    if lease is None:
        return None
    with lease:
        luma = lease.video().data[: lease.height]
        return round(float(luma.mean())) if luma.std() < 4 else -1
