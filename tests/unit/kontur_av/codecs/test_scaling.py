"""Pictures made smaller."""

from threading import Thread

import numpy as np

from kontur_av.codecs.scaling import shrink
from kontur_av.media import empty_picture


def test_threads_scale_at_once():
    """With one scaler for all of them, the process ends by a segmentation fault."""
    wrong = []

    def work(size, value):
        picture, small = empty_picture(*size), empty_picture(*(side // 2 for side in size))
        picture[:] = value
        for _ in range(100):
            small[:] = 0
            shrink(picture, small)
            wrong.extend(np.unique(small[abs(small.astype(int) - value) > 1]))

    threads = [Thread(target=work, args=one) for one in (((640, 480), 60), ((320, 240), 200))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong
