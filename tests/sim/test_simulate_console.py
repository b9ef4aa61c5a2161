"""What a simulated console answers its terminals, with a radio between them and the ground."""

from dataclasses import replace

from kontur_av.clock import NS_PER_S
from pipelines.session.requests import parse_answer
from pipelines.session.setup.setup_file import load_setup
from pipelines.virtual.session import Selection, Simulation
from pipelines.virtual.workers import Workers
from telepresence.link.radio import load_radio


def answers(tmp_path, radio, selections, seconds):
    """The last answer to each telecommand of the script."""
    file = tmp_path / "radio.toml"
    file.write_text(radio)
    setup = replace(load_setup("taskboard"), radio=load_radio(str(file)))
    with Workers() as workers:
        simulation = Simulation(setup, workers, seed=1, media=False, selections=selections)
        simulation.run(round(seconds * NS_PER_S))
    return [parse_answer(octets.splitlines()[-1]) for octets in simulation.answers.values()]


def test_an_acknowledgement_comes_after_the_radios_delay_there_and_back(tmp_path):
    script = [Selection(NS_PER_S, "static"), Selection(2 * NS_PER_S, "roof")]
    done, unknown = answers(tmp_path, "delay_ms = 40.0\n", script, 3)
    assert done.ok and done.camera == "static"
    assert 80 <= done.round_trip_ms < 90
    assert unknown.mistake and "roof" in unknown.error


def test_a_console_that_hears_nothing_from_the_ground_gives_up(tmp_path):
    dark = "[[blackouts]]\nstart_s = 1\nseconds = 5\n"
    (gone,) = answers(tmp_path, dark, [Selection(2 * NS_PER_S, "static")], 4)
    assert gone.error == "select static: no acknowledgement came"
