"""Options that several commands have."""

import pytest

from pipelines.cli import make_parser
from pipelines.session.options import radio_changes
from pipelines.session.setup.setup_file import load_setup


@pytest.mark.parametrize("command", ["stream", "link", "simulate"])
def test_every_session_can_begin_in_the_middle_of_a_pass(command):
    options = ["--setup", "taskboard", "--radio", "iss-pass", "--radio-start", "200"]
    args = make_parser().parse_args([command, "--seconds", "1", *options])
    setup = load_setup(args.setup, changes=radio_changes(args), radio_start_s=args.radio_start)
    assert (setup.radio_profile.name, setup.radio_profile.start_s) == ("iss-pass", 200)
