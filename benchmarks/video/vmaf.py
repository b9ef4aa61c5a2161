"""VMAF, by an FFmpeg that has libvmaf: the one of imageio-ffmpeg, or one on the PATH.

VMAF weighs detail, contrast and motion by what viewers said (Z. Li et al., "Toward a practical
perceptual video quality metric", 2016). It looks at the luma only. Debian's FFmpeg and PyAV's have
no libvmaf.
"""

import json
import shutil
import subprocess
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from kontur_av.media import NEUTRAL_CHROMA

_TIMEOUT_S = 600.0

Luma = NDArray[np.uint8]


@cache
def vmaf_program() -> str | None:
    """The FFmpeg to use; None if there is none with libvmaf."""
    candidates = [shutil.which("ffmpeg")]
    try:
        import imageio_ffmpeg

        candidates.insert(0, imageio_ffmpeg.get_ffmpeg_exe())
    except (ImportError, RuntimeError):
        pass
    for program in filter(None, candidates):
        told = subprocess.run(
            [program, "-hide_banner", "-filters"], capture_output=True, text=True, check=False
        )
        if " libvmaf " in told.stdout:
            return program
    return None


def vmaf(pairs: Iterable[tuple[Luma, Luma]]) -> list[float]:
    """VMAF (model vmaf_v0.6.1, 0 to 100) of each pair of picture and original, in order of time.

    Empty without an FFmpeg that has libvmaf, and for no pairs. RuntimeError if it fails.
    """
    program = vmaf_program()
    if program is None:
        return []
    with TemporaryDirectory(prefix="kontur-av-vmaf-") as temporary:
        folder = Path(temporary)
        shape, count = (0, 0), 0
        with (folder / "seen").open("wb") as seen, (folder / "original").open("wb") as original:
            for picture, wanted in pairs:
                shape, count = picture.shape, count + 1
                _write(seen, picture)
                _write(original, wanted)
        if not count:
            return []
        form = ["-f", "rawvideo", "-pix_fmt", "yuv420p", "-s", f"{shape[1]}x{shape[0]}", "-r", "30"]
        command = [program, "-v", "error", *form, "-i", "seen", *form, "-i", "original"]
        command += ["-lavfi", "libvmaf=log_fmt=json:log_path=log.json:n_threads=2"]
        done = subprocess.run(
            [*command, "-f", "null", "-"],
            cwd=folder,
            capture_output=True,
            text=True,
            timeout=_TIMEOUT_S,
            check=False,
        )
        if done.returncode:
            raise RuntimeError(f"VMAF could not be computed: {done.stderr.strip()[-200:]}")
        return scores((folder / "log.json").read_text())


def scores(log: str) -> list[float]:
    """The score of each picture in a log of libvmaf (JSON)."""
    return [float(frame["metrics"]["vmaf"]) for frame in json.loads(log)["frames"]]


def _write(file: BinaryIO, luma: Luma) -> None:
    file.write(luma.tobytes())
    file.write(bytes([NEUTRAL_CHROMA]) * (luma.size // 2))
