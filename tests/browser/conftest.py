"""One Chromium for all tests here, with a camera of numbered pictures and a tone to hear."""

from pathlib import Path

import pytest
from common import write_tone

pytest.register_assert_rewrite("browser", "running_session")

import browser as browsers  # noqa: E402
from numbered_pictures import write_pictures  # noqa: E402

ROOM = Path(__file__).parent
#: The first number of the camera's pictures; a tone that noise suppression takes for a voice.
CAMERA_FROM, TONE_HZ = 2001, 440


def pytest_collection_modifyitems(items):
    """Mark all tests here: they need a browser, and they start processes."""
    for item in items:
        if item.path.is_relative_to(ROOM):
            item.add_marker(pytest.mark.browser)
            item.add_marker(pytest.mark.realtime)


@pytest.fixture(scope="session")
def chromium(tmp_path_factory):
    if (lacking := browsers.missing()) is not None:
        pytest.skip(lacking)
    directory = tmp_path_factory.mktemp("devices")
    camera, microphone = directory / "camera.y4m", directory / "microphone.wav"
    write_pictures(camera, 60, first=CAMERA_FROM)
    write_tone(microphone, TONE_HZ, pauses=True)
    # A session over TLS has a certificate of its own.
    flags = ["ignore-certificate-errors"]
    with browsers.Browser(
        camera=camera, microphone=microphone, flags=flags, size=(1280, 900)
    ) as running:
        yield running


@pytest.fixture
def browser(chromium):
    """The browser without pages. No script of them may fail; their servers may go."""
    chromium.begin_anew()
    yield chromium
    chromium.assert_no_errors(server_gone=True)
    chromium.begin_anew()


@pytest.fixture
def start_browser():
    """start_browser(camera=..., ...): a running browser, which ends after the test in any case."""
    if (lacking := browsers.missing()) is not None:
        pytest.skip(lacking)
    started = []

    def start(**options):
        started.append(browsers.Browser(**options))
        return started[-1]

    yield start
    for one in started:
        one.end()
