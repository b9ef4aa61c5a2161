"""Whether a session has tasks."""

from dataclasses import replace

import pytest

from kontur_av.errors import ConfigError
from pipelines.cli import make_parser
from pipelines.commands.session_parts import task_options
from pipelines.session.options import stream_options
from pipelines.session.setup.segments import Segment
from pipelines.session.setup.setup_file import BUILT_IN

SETUP = BUILT_IN["spacejustin"]


def request(setup, *words):
    args = make_parser("stream").parse_args(["stream", "--joystick", "page", *words])
    return task_options(stream_options(args), setup, tuple(Segment))


def test_a_setup_may_wish_tasks_as_the_option_does_unless_a_partner_drives_the_robot():
    assert request(SETUP) is None
    with_tasks = replace(SETUP, tasks=True)
    assert (
        request(with_tasks)
        == request(SETUP, "--tasks")
        == request(with_tasks, "--tasks")
        is not None
    )
    assert request(with_tasks, "--leds", "panel:5000").leds == ("panel", 5000)
    with pytest.raises(ConfigError, match="tasks are the cosmonaut's"):
        request(replace(SETUP, partner_arm="shared"), "--tasks")
    with pytest.raises(ConfigError, match="tasks are the cosmonaut's"):
        replace(SETUP, partner_arm="shared", tasks=True)
