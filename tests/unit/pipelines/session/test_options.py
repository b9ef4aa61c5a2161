"""Options that several commands have."""

import pytest

from pipelines.cli import make_parser
from pipelines.session.options import asked_setup, stream_options


@pytest.mark.parametrize("command", ["stream", "link", "simulate"])
def test_every_session_can_begin_in_the_middle_of_a_pass(command):
    options = ["--setup", "taskboard", "--radio", "iss-pass", "--radio-start", "200"]
    args = make_parser().parse_args([command, "--seconds", "1", *options])
    setup = asked_setup(stream_options(args))
    assert (setup.radio_profile.name, setup.radio_profile.start_s) == ("iss-pass", 200)
