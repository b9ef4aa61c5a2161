"""Whether a session has tasks."""

from argparse import ArgumentParser
from dataclasses import replace

import pytest

from kontur_av.errors import ConfigError
from pipelines.commands.session_parts import add_task_arguments, task_options
from pipelines.session.setup.segments import Segment
from pipelines.session.setup.setup_file import BUILT_IN

SETUP = BUILT_IN["spacejustin"]


def request(setup, *words):
    parser = ArgumentParser()
    parser.add_argument("--joystick", default="page")
    parser.add_argument("--robot", default="sim")
    add_task_arguments(parser)
    return task_options(parser.parse_args(words), setup, tuple(Segment))


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
