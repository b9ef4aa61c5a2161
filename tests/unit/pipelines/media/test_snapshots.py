"""A snapshot that cannot be written."""

import numpy as np

from pipelines.media.process_display import _write


def test_a_failed_write_is_no_snapshot(tmp_path):
    picture = np.full((72, 64), 128, np.uint8)
    assert _write(tmp_path, "ground-stereo-0001s", picture, halves=True) == [True] * 3
    assert len(list(tmp_path.glob("*.png"))) == 3
    assert _write(tmp_path / "missing", "space-0001s", picture, halves=False) == [False]
