"""Scenes are drawn once in a process of tests, before simulations fork their coders."""

import pytest

from kontur_av.media import empty_picture
from telepresence.world import render, scripted_state
from telepresence.world.scenes import read_speech

#: What most sessions show, and its size.
VIEWS, SIZE = ("left", "right", "static", "cabin"), (640, 480)


@pytest.fixture(scope="session", autouse=True)
def scenes_are_drawn():
    """Otherwise each coder draws its backgrounds and reads its speech again, for a second."""
    into = empty_picture(*SIZE)
    for view in VIEWS:
        render(view, scripted_state(0), into)
    for speaker in ("ground", "cabin"):
        read_speech(speaker)
