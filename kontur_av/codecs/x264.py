"""libx264 itself, by ctypes, for what PyAV does not pass on.

Cap and rate change without a key picture, and each macroblock may have a quantiser of its own.
After a loss, pictures refer to those before it.
The library is the one in PyAV's wheel, or else the system's; x264.h names the structures.
"""

import re
from collections.abc import Sequence
from ctypes import (
    CDLL,
    POINTER,
    Structure,
    byref,
    c_char,
    c_char_p,
    c_double,
    c_float,
    c_int,
    c_int64,
    c_void_p,
    cast,
    create_string_buffer,
    sizeof,
    string_at,
)
from ctypes.util import find_library
from fractions import Fraction
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from kontur_av.codecs.av_encoder import BLOCK, EncodedPicture, FinerPart
from kontur_av.codecs.carried import carried_by_pyav
from kontur_av.errors import ConfigError
from kontur_av.media import I420

#: X264_BUILD, from and to: between them no structure used here has changed.
_BUILDS = range(155, 166)
#: More than `x264_param_t` has in any of them.
_PARAM_OCTETS = 4096
_SIZE_AT = 7
_TYPE_AUTO, _TYPE_KEYFRAME = 0, 6
_CSP_I420 = 2
#: The colours are those of `colours.tell_bt601`.
_ALWAYS = (
    "psnr=1:threads=1:repeat-headers=1:annexb=1"
    ":colorprim=smpte170m:transfer=smpte170m:colormatrix=smpte170m"
)
_ARGUMENTS = {
    "param_default_preset": (c_void_p, c_char_p, c_char_p),
    "param_parse": (c_void_p, c_char_p, c_char_p),
    "picture_init": (c_void_p,),
    "encoder_reconfig": (c_void_p, c_void_p),
    "encoder_headers": (c_void_p,) * 3,
    "encoder_encode": (c_void_p,) * 5,
    "encoder_invalidate_reference": (c_void_p, c_int64),
    "encoder_close": (c_void_p,),
}

#: A function of the C library that needs no arguments, in the place of one that logs.
_IGNORED = cast(CDLL(None).getppid, c_void_p).value


class _Image(Structure):
    _fields_ = (
        ("csp", c_int),
        ("planes", c_int),
        ("strides", c_int * 4),
        ("plane", c_void_p * 4),
    )


class _Properties(Structure):
    _fields_ = (
        ("quantiser_offsets", POINTER(c_float)),
        ("quant_offsets_free", c_void_p),
        ("mb_info", c_void_p),
        ("mb_info_free", c_void_p),
        ("ssim", c_double),
        ("psnr_avg", c_double),
        ("psnr", c_double * 3),
        ("crf_avg", c_double),
    )


class _Picture(Structure):
    _fields_ = (
        ("type", c_int),
        ("quantiser_plus_1", c_int),
        ("pic_struct", c_int),
        ("keyframe", c_int),
        ("pts", c_int64),
        ("dts", c_int64),
        ("param", c_void_p),
        ("image", _Image),
        ("properties", _Properties),
        ("rest", c_char * 512),
    )


class _Nal(Structure):
    _fields_ = (
        ("ref_idc", c_int),
        ("type", c_int),
        ("long_startcode", c_int),
        ("first_mb", c_int),
        ("last_mb", c_int),
        ("octets", c_int),
        ("payload", c_void_p),
        ("padding", c_int),
    )


class Library(NamedTuple):
    """A libx264 that can be used. path: what the loader was given. build: X264_BUILD."""

    path: str
    build: int
    functions: Any


class X264Encoder:
    """An `OpenEncoder`. Raises ConfigError if x264 refuses a size or an option.

    options: as of FFmpeg's libx264.
    """

    def __init__(
        self,
        library: Library,
        size: tuple[int, int],
        rate: Fraction,
        gop: int,
        options: dict[str, str],
    ) -> None:
        self._x264 = library.functions
        self._size = width, height = size
        self._param = create_string_buffer(_PARAM_OCTETS)
        preset, tune = options["preset"].encode(), options["tune"].encode()
        if self._x264.x264_param_default_preset(self._param, preset, tune):
            raise ConfigError(f"libx264 has no preset {options['preset']!r}")
        self._set(f"keyint={gop}:fps={rate.numerator}/{rate.denominator}:{_ALWAYS}")
        self._set(f"intra-refresh={options['intra-refresh']}:{options['x264-params']}")
        self._set(_rates(options))
        self._measure_silently()
        (c_int * 2).from_buffer(self._param, _SIZE_AT * sizeof(c_int))[:] = [*size]
        self._encoder = getattr(self._x264, f"x264_encoder_open_{library.build}")(self._param)
        if not self._encoder:
            raise ConfigError(f"libx264 refuses {width}x{height} at {float(rate):g} Hz")
        self._input, self._output = _Picture(), _Picture()
        self._x264.x264_picture_init(byref(self._input))
        image = self._input.image
        image.csp, image.planes = _CSP_I420, 3
        image.strides[:3] = width, width // 2, width // 2
        self._nals, self._count = POINTER(_Nal)(), c_int()
        self._number = self._key = 0
        found = re.search(r"dpb-size=(\d+)", options["x264-params"])
        #: Pictures to which a picture may refer; 0: after a loss, a key picture is needed.
        self._kept = int(found[1]) if found else 0
        self._parts: Sequence[FinerPart] = ()
        self._finer = np.zeros((-(-height // BLOCK), -(-width // BLOCK)), np.float32)

    def encode(
        self, picture: I420, number: int, parts: Sequence[FinerPart], *, keyframe: bool
    ) -> EncodedPicture:
        given, coded = self._input, self._output
        luma, octets = self._size[0] * self._size[1], picture.ctypes.data
        given.image.plane[:3] = octets, octets + luma, octets + luma * 5 // 4
        given.type = _TYPE_KEYFRAME if keyframe else _TYPE_AUTO
        given.pts = number
        if parts != self._parts:
            self._mark(parts)
        taken = self._x264.x264_encoder_encode(
            self._encoder, byref(self._nals), byref(self._count), byref(given), byref(coded)
        )
        if taken <= 0:
            raise RuntimeError(f"libx264 made no access unit ({taken})")
        self._number = number
        if coded.keyframe:
            self._key = number
        data = string_at(self._nals[0].payload, taken)
        squares = luma * 255.0**2 / 10 ** (coded.properties.psnr[0] / 10)
        return EncodedPicture(data, bool(coded.keyframe), coded.quantiser_plus_1 - 1.0, squares)

    def headers(self) -> bytes:
        taken = self._x264.x264_encoder_headers(
            self._encoder, byref(self._nals), byref(self._count)
        )
        return string_at(self._nals[0].payload, max(taken, 0))

    def follow(self, options: dict[str, str]) -> bool:
        self._set(_rates(options))
        return bool(self._x264.x264_encoder_reconfig(self._encoder, self._param) == 0)

    def invalidate(self, lost: int) -> bool:
        whole = self._number - lost
        if lost >= self._kept or whole < self._key:
            return False
        first = whole + 1
        return bool(self._x264.x264_encoder_invalidate_reference(self._encoder, first) == 0)

    def _mark(self, parts: Sequence[FinerPart]) -> None:
        self._parts = parts
        self._finer[:] = 0
        for left, top, width, height, steps in reversed(parts):
            rows = slice(top // BLOCK, -(-(top + height) // BLOCK))
            self._finer[rows, left // BLOCK : -(-(left + width) // BLOCK)] = -steps
        offsets = self._finer.ctypes.data_as(POINTER(c_float)) if parts else None
        self._input.properties.quantiser_offsets = offsets

    def _set(self, options: str) -> None:
        for option in options.split(":"):
            name, _, value = option.partition("=")
            if self._x264.x264_param_parse(self._param, name.encode(), value.encode()):
                raise ConfigError(f"libx264 refuses {option}")

    def _measure_silently(self) -> None:
        """x264 measures the loss only while it logs; `pf_log` is two pointers before its level."""
        before = self._param.raw
        self._set("log=-1")
        pairs = zip(before, self._param.raw, strict=True)
        at = next(at for at, (old, new) in enumerate(pairs) if old != new)
        self._set("log=2")
        c_void_p.from_buffer(self._param, at - 2 * sizeof(c_void_p)).value = _IGNORED

    def __del__(self) -> None:
        if encoder := getattr(self, "_encoder", None):
            self._x264.x264_encoder_close(encoder)


def _rates(options: dict[str, str]) -> str:
    names = ("bitrate", "b"), ("vbv-maxrate", "maxrate"), ("vbv-bufsize", "bufsize")
    return ":".join(f"{name}={int(options[of]) // 1000}" for name, of in names)


def found() -> Library | None:
    """Load a libx264 whose build is known; None without one."""
    return looked_for()[0]


@cache
def looked_for() -> tuple[Library | None, str]:
    """Return what `found` does, and why there is none, in words."""
    why = "neither PyAV's wheel nor the system has a libx264 to load"
    for path in (carried_by_pyav("x264"), find_library("x264")):
        build = re.search(r"\.(\d+)(?:\.dylib)?$", str(path))
        if build is None:
            continue
        name = f"libx264 {build[1]}"
        if int(build[1]) not in _BUILDS:
            why = f"{name} is of an unknown build"
            continue
        try:
            functions = CDLL(str(path))
            opened = getattr(functions, f"x264_encoder_open_{build[1]}")
        except (OSError, AttributeError) as error:
            why = f"{name} cannot be loaded: {error}"
            continue
        opened.restype = c_void_p
        for function, arguments in _ARGUMENTS.items():
            getattr(functions, f"x264_{function}").argtypes = arguments
        opened.argtypes = (c_void_p,)
        library = Library(str(path), int(build[1]), functions)
        if _codes(library):
            return library, ""
        why = f"{name} codes a test picture wrongly"
    return None, why


def _codes(library: Library) -> bool:
    """Return whether it codes a grey picture, and tells of it what such a picture can have."""
    grey = np.full((96, 64), 128, np.uint8)
    options = {"preset": "superfast", "tune": "zerolatency", "intra-refresh": "1", "b": "100000"}
    options |= {"maxrate": "100000", "bufsize": "10000", "x264-params": "qpmax=51"}
    try:
        encoder = X264Encoder(library, (64, 64), Fraction(30), 60, options)
        coded = encoder.encode(grey, 0, (), keyframe=True)
    except (ConfigError, RuntimeError, StopIteration):
        return False
    begins = coded.data.startswith(b"\0\0\0\1")
    return begins and coded.flagged and 0 < coded.quantiser <= 51 and coded.squares < grey.size
