"""What becomes of telecommands for a camera, with a radio between the console and the ground."""

from dataclasses import replace

from kontur_av.clock import NS_PER_S
from pipelines.mission.tmtc_messages import selection_error
from pipelines.session.setup.setup_file import load_setup
from pipelines.virtual.session import Selection, Simulation
from pipelines.virtual.workers import Workers
from telepresence.link.radio import load_radio


def answers(tmp_path, radio, selections, seconds):
    """The last news of each telecommand of the script."""
    file = tmp_path / "radio.toml"
    file.write_text(radio)
    setup = replace(load_setup("taskboard"), radio=load_radio(str(file)))
    with Workers() as workers:
        simulation = Simulation(setup, workers, seed=1, media=False, selections=selections)
        simulation.run(round(seconds * NS_PER_S))
    return [simulation.answers[number] for number in range(len(selections))]


def test_the_completion_comes_after_the_radios_delay_there_and_back(tmp_path):
    script = [Selection(NS_PER_S, "static"), Selection(2 * NS_PER_S, "roof")]
    done, unknown = answers(tmp_path, "delay_ms = 40.0\n", script, 3)
    assert done.ok and done.stage == "completed"
    assert 80 <= done.round_trip_ms < 90
    assert unknown.mistake and unknown.tries == 0
    assert unknown.reason == "unknown camera roof: choose one of stereo, static"


def test_a_camera_is_selected_after_a_loss_of_signal_unless_it_lasts_too_long(tmp_path):
    dark = "[[blackouts]]\nstart_s = 1\nseconds = 5\n"
    script = [Selection(2 * NS_PER_S, "static"), Selection(3 * NS_PER_S, "stereo")]
    earlier, later = answers(tmp_path, dark, script, 8)
    assert selection_error("select static", earlier) == "select static: a later request came"
    assert later.ok and later.tries > 1
    dark = "[[blackouts]]\nstart_s = 1\nseconds = 40\n"
    (waits,) = answers(tmp_path, dark, [Selection(2 * NS_PER_S, "static")], 10)
    assert waits.stage == "unacknowledged" and waits.tries > 2 and not waits.done
    (gone,) = answers(tmp_path, dark, [Selection(2 * NS_PER_S, "static")], 38)
    assert gone.done and not gone.verified
    assert selection_error("select static", gone) == "select static: no acknowledgement came"
