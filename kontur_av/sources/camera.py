"""A camera of this machine: Video4Linux2, through FFmpeg's device library."""

import os
import stat
from pathlib import Path
from typing import Any

import av

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ConfigError
from kontur_av.sources.live import LiveCapture, in_time
from kontur_av.sources.v4l2 import FORMATS, CameraMode, ask_camera, choose_mode

#: A driver that has not opened the camera after this time is considered hung.
_OPEN_TIMEOUT_S = 5.0


def check_camera(device: str) -> None:
    """Raise ConfigError, with the fix, if `device` is no usable camera.

    The check opens the device briefly, in the same way as `CameraVideo`.
    """
    _check_node(device)
    try:
        in_time(lambda: av.open(device, format="v4l2").close(), _OPEN_TIMEOUT_S)
    except (av.FFmpegError, OSError, ValueError) as error:
        if type(error) is TimeoutError:
            answer = "does not answer: unplug it and plug it in again"
            raise ConfigError(f"camera {device!r} {answer}") from None
        raise _cannot_open(device, error) from None


def _cannot_open(device: str, error: Exception) -> ConfigError:
    reason = getattr(error, "strerror", None) or str(error)
    return ConfigError(
        f"camera {device!r} cannot be opened ({reason}): end the program that uses it, "
        "or choose from `kontur-av devices`"
    )


def _check_node(device: str) -> None:
    try:
        mode = Path(device).stat().st_mode
    except OSError:
        raise ConfigError(
            f"no camera {device!r}: plug one in, or choose from `kontur-av devices`"
        ) from None
    if not stat.S_ISCHR(mode):
        raise ConfigError(f"{device!r} is no device: give one such as v4l2:/dev/video0")
    if not os.access(device, os.R_OK | os.W_OK):
        raise ConfigError(f"may not open {device!r}: add yourself to the group `video`")


class CameraVideo(LiveCapture):
    """Pictures of a camera (a `VideoSource`): the newest one, stamped by the driver.

    A camera that disappears is opened again, twice a second.

    spec: the device. Raises ConfigError if the camera cannot be opened.
    """

    check_source = staticmethod(check_camera)
    #: FFmpeg's name of the device library.
    _demuxer = "v4l2"

    def _first(
        self, spec: str, width: int, height: int, fps: float, *, wait: bool
    ) -> av.container.InputContainer:
        mode = None
        if self._demuxer == "v4l2":
            _check_node(spec)
            found = ask_camera(Path(spec))
            modes = found.modes if found else ()
            mode = choose_mode(modes, CameraMode("", width, height, fps))
        self._options = {"video_size": f"{width}x{height}", "framerate": f"{fps:g}"}
        if mode is not None:
            self._options = {
                "input_format": FORMATS[mode.fourcc],
                "video_size": f"{mode.width}x{mode.height}",
                "framerate": f"{mode.fps or fps:g}",
            }
        try:
            return self._open()
        except (av.FFmpegError, OSError, ValueError) as error:
            raise _cannot_open(spec, error) from None

    def _open(self) -> av.container.InputContainer:
        try:
            return av.open(self._place, format=self._demuxer, options=self._options)
        except (av.FFmpegError, ValueError):
            # The driver lacks this size or rate; use its default instead.
            return av.open(self._place, format=self._demuxer)

    def _stated_ns(self, packet: "av.Packet[Any]", frame: av.VideoFrame, now_ns: int) -> int | None:
        """The driver's stamp if it is on the monotonic clock."""
        if packet.pts is None or packet.time_base is None:
            return None
        stated_ns = int(packet.pts * packet.time_base * NS_PER_S)
        return stated_ns if 0 <= now_ns - stated_ns < NS_PER_S // 2 else None
