"""GStreamer's shmsink and shmsrc through their C interface, as C programs use them.

`gst-launch-1.0` can neither stamp a picture nor report its arrival. It would need a pipe on each
side, and the pipes would be measured, too. The caller's thread pushes a picture into the pad of
shmsink, which copies it into shared memory and notifies all its clients before it returns. A
reader runs the pipeline `shmsrc ! appsink` and reads the picture in place.
"""

import ctypes
import os
import tempfile
from collections.abc import Callable
from contextlib import suppress
from ctypes import POINTER, Structure, c_char_p, c_int, c_size_t, c_uint64, c_void_p
from pathlib import Path
from shutil import rmtree
from typing import Any

from benchmarks.fanout.ways import (
    HEIGHT,
    PICTURE_OCTETS,
    WIDTH,
    Octets,
    PublishingEnd,
    ReadingEnd,
    noise,
    stamp_picture,
)

_CAPS = f"video/x-raw,format=I420,width={WIDTH},height={HEIGHT},framerate=30/1"
#: Room for the pictures that readers still hold.
_POOL_OCTETS = 64 * PICTURE_OCTETS

_SHARED_MEMORY = Path("/dev/shm")
#: A file with the process id of the owner of the shared memory.
_OWNER = "owner"

_NULL, _PLAYING = 1, 4  # GstState
_FAILURE = 0  # GstStateChangeReturn
_FORMAT_TIME = 3
_MAP_READ = 1
_FLOW_OK = 0


class _MapInfo(Structure):
    """GstMapInfo (gstmemory.h)."""

    _fields_ = (
        ("memory", c_void_p),
        ("flags", c_int),
        ("data", c_void_p),
        ("size", c_size_t),
        ("maxsize", c_size_t),
        ("user_data", c_void_p * 4),
        ("_reserved", c_void_p * 4),
    )


#: Results and arguments of the C functions that are used.
_FUNCTIONS: dict[str, tuple[Any, ...]] = {
    "gst_init": (None, c_void_p, c_void_p),
    "gst_element_factory_find": (c_void_p, c_char_p),
    "gst_element_factory_make": (c_void_p, c_char_p, c_char_p),
    "gst_util_set_object_arg": (None, c_void_p, c_char_p, c_char_p),
    "gst_parse_launch": (c_void_p, c_char_p, c_void_p),
    "gst_bin_get_by_name": (c_void_p, c_void_p, c_char_p),
    "gst_element_set_state": (c_int, c_void_p, c_int),
    "gst_element_get_static_pad": (c_void_p, c_void_p, c_char_p),
    "gst_event_new_stream_start": (c_void_p, c_char_p),
    "gst_caps_from_string": (c_void_p, c_char_p),
    "gst_event_new_caps": (c_void_p, c_void_p),
    "gst_segment_new": (c_void_p,),
    "gst_segment_init": (None, c_void_p, c_int),
    "gst_event_new_segment": (c_void_p, c_void_p),
    "gst_pad_send_event": (c_int, c_void_p, c_void_p),
    "gst_buffer_new_wrapped_full": (
        *(c_void_p, c_int, c_void_p, c_size_t, c_size_t, c_size_t, c_void_p, c_void_p),
    ),
    "gst_pad_chain": (c_int, c_void_p, c_void_p),
    "gst_app_sink_try_pull_sample": (c_void_p, c_void_p, c_uint64),
    "gst_sample_get_buffer": (c_void_p, c_void_p),
    "gst_buffer_map": (c_int, c_void_p, POINTER(_MapInfo), c_int),
    "gst_buffer_unmap": (None, c_void_p, POINTER(_MapInfo)),
    "gst_mini_object_unref": (None, c_void_p),
}


class _Library:
    """The C functions by name. OSError where GStreamer is not installed."""

    def __init__(self) -> None:
        core = ctypes.CDLL("libgstreamer-1.0.so.0")
        app = ctypes.CDLL("libgstapp-1.0.so.0")
        for name, (result, *arguments) in _FUNCTIONS.items():
            function = getattr(app if name.startswith("gst_app_") else core, name)
            function.restype, function.argtypes = result, arguments
            setattr(self, name, function)
        self.gst_init(None, None)

    def __getattr__(self, name: str) -> Callable[..., Any]:
        raise AttributeError(name)


def lacking() -> str | None:
    """What is missing of GStreamer, and the packages that have it; None if nothing is.

    It looks in a child process, because GStreamer starts threads and this process forks later.
    """
    read_fd, write_fd = os.pipe()
    child = os.fork()
    if child == 0:
        os.write(write_fd, (_lacking() or "").encode())
        os._exit(0)
    os.close(write_fd)
    with os.fdopen(read_fd, "rb") as pipe:
        text = pipe.read().decode()
    os.waitpid(child, 0)
    return text or None


def _lacking() -> str | None:
    try:
        gst = _Library()
    except (OSError, AttributeError):
        return "GStreamer is not installed (Debian packages gstreamer1.0-plugins-bad, -base)"
    for element, package in (("shmsink", "bad"), ("shmsrc", "bad"), ("appsink", "base")):
        if not gst.gst_element_factory_find(element.encode()):
            return f"GStreamer's {element} is not installed (gstreamer1.0-plugins-{package})"
    return None


class ShmSinkWay:
    """One shmsink, and a shmsrc for each reader."""

    name = "GStreamer shm"

    def __init__(self) -> None:
        self._directory = Path()

    def prepare(self, readers: int, processes: Any) -> None:
        self._directory = Path(tempfile.mkdtemp(prefix="kav"))

    def publishing_end(self) -> PublishingEnd:
        (self._directory / _OWNER).write_text(f"{os.getpid()}")
        return _Publishing(_Library(), self._directory / "socket")

    def reading_end(self, reader: int) -> ReadingEnd:
        return _Reading(_Library(), self._directory / "socket")

    def clear(self) -> None:
        # shmsink removes its shared memory itself, unless it was killed.
        with suppress(FileNotFoundError):
            owner = int((self._directory / _OWNER).read_text())
            for leftover in _SHARED_MEMORY.glob(f"shmpipe.{owner:5d}.*"):
                leftover.unlink()
        rmtree(self._directory, ignore_errors=True)


class _Publishing:
    def __init__(self, gst: Any, socket: Path) -> None:
        self._gst = gst
        self._picture = noise()
        self._element = gst.gst_element_factory_make(b"shmsink", None)
        for name, value in {
            "socket-path": str(socket),
            "shm-size": str(_POOL_OCTETS),
            "wait-for-connection": "false",
            "sync": "false",
            "async": "false",
            "enable-last-sample": "false",
        }.items():
            gst.gst_util_set_object_arg(self._element, name.encode(), value.encode())
        if gst.gst_element_set_state(self._element, _PLAYING) == _FAILURE:
            raise RuntimeError("shmsink does not start")
        self._pad = gst.gst_element_get_static_pad(self._element, b"sink")
        segment = gst.gst_segment_new()
        gst.gst_segment_init(segment, _FORMAT_TIME)
        for event in (
            gst.gst_event_new_stream_start(b"bench"),
            gst.gst_event_new_caps(gst.gst_caps_from_string(_CAPS.encode())),
            gst.gst_event_new_segment(segment),
        ):
            if not gst.gst_pad_send_event(self._pad, event):
                raise RuntimeError("shmsink refuses the format")

    def publish(self, now_ns: int, sequence: int) -> None:
        stamp_picture(self._picture, now_ns, sequence)
        address, octets = self._picture.ctypes.data, PICTURE_OCTETS
        buffer = self._gst.gst_buffer_new_wrapped_full(0, address, octets, 0, octets, None, None)
        if self._gst.gst_pad_chain(self._pad, buffer) != _FLOW_OK:
            raise RuntimeError("shmsink refuses a picture")

    def close(self) -> None:
        # It removes its socket and its shared memory.
        self._gst.gst_element_set_state(self._element, _NULL)


class _Reading:
    def __init__(self, gst: Any, socket: Path) -> None:
        self._gst = gst
        self._pipeline = gst.gst_parse_launch(
            f'shmsrc socket-path="{socket}" is-live=true ! {_CAPS} ! '
            "appsink name=end sync=false max-buffers=1 drop=true".encode(),
            None,
        )
        if not self._pipeline or gst.gst_element_set_state(self._pipeline, _PLAYING) == _FAILURE:
            raise RuntimeError("shmsrc does not start")
        self._end = gst.gst_bin_get_by_name(self._pipeline, b"end")
        self._map = _MapInfo()
        self._sample: int | None = None
        self._buffer: int | None = None

    def take(self, timeout_ns: int) -> Octets | None:
        gst = self._gst
        self._sample = gst.gst_app_sink_try_pull_sample(self._end, timeout_ns)
        if self._sample is None:
            return None
        self._buffer = gst.gst_sample_get_buffer(self._sample)
        if not gst.gst_buffer_map(self._buffer, ctypes.byref(self._map), _MAP_READ):
            raise RuntimeError("a picture cannot be mapped")
        if self._map.size != PICTURE_OCTETS:
            raise RuntimeError(f"a picture of {self._map.size} octets")
        return (ctypes.c_uint8 * PICTURE_OCTETS).from_address(self._map.data)

    def release(self) -> None:
        self._gst.gst_buffer_unmap(self._buffer, ctypes.byref(self._map))
        self._gst.gst_mini_object_unref(self._sample)

    def close(self) -> None:
        self._gst.gst_element_set_state(self._pipeline, _NULL)
