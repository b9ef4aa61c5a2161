"""The file of a sweep: the setups that its grids make, and mistakes in one line."""

import pytest

from kontur_av.errors import ConfigError
from pipelines.virtual.campaign.sweep_file import load_sweep


def sweep_of(tmp_path, text):
    path = tmp_path / "mine.toml"
    path.write_text(text)
    return load_sweep(path)


def test_grids_make_the_setups_of_every_choice_and_each_once(tmp_path):
    sweep = sweep_of(
        tmp_path,
        """
        seconds = 10
        seeds = 3
        setup = "spacejustin"
        [[grid]]
        radio_delay_ms = [0, 25.5]
        uplink_video.cap_kbps = [60, 80]
        [[grid]]
        setup = "taskboard"
        radio = ["iss-pass", {base = "iss-pass", frame_loss = 0.5}]
        radio_start_s = 60
        [[grid]]
        cameras = [["static"], ["stereo", "static"]]
        downlink_voice = false
        """,
    )
    delays, radios, cameras = sweep.cases[:4], sweep.cases[4:6], sweep.cases[6:]
    found = [(case.setup.radio_delay_ms, case.setup.uplink_video.cap_bps) for case in delays]
    assert found == [(0, 60_000), (0, 80_000), (25.5, 60_000), (25.5, 80_000)]
    assert [case.setup.name for case in radios] == ["taskboard"] * 2
    assert [case.setup.radio_profile.start_s for case in radios] == [60, 60]
    assert radios[1].setup.radio_profile.frame_loss == 0.5
    assert radios[1].values["radio"] == "base=iss-pass frame_loss=0.5"
    assert [case.setup.cameras for case in cameras] == [("static",), ("stereo", "static")]
    assert all(case.setup.downlink_voice is None for case in cameras)
    assert len(sweep.tasks()) == 8 * 3
    assert [task.seed for task in sweep.tasks()[:4]] == [1, 2, 3, 1]
    assert sweep.x_field == "radio_delay_ms"
    text = "seconds = 1\n[[grid]]\nradio_delay_ms = [0, 5]\n[[grid]]\nradio_delay_ms = [5, 9]\n"
    sweep = sweep_of(tmp_path, text)
    assert [case.setup.radio_delay_ms for case in sweep.cases] == [0, 5, 9]


GRID = "seconds = 1\n[[grid]]\n"
HAND = "[[grid]]\nhand = ['direct']\n"
UNKNOWN = "unknown field uplink_video.cap_kbp: the nearest one is uplink_video.cap_kbps"


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("seconds = 1\n[[grid]\n", "is not TOML: "),
        ("[[grid]]\nradio_delay_ms = [0]\n", "needs seconds"),
        ("seconds = 1\n", "a sweep needs grid"),
        (f"seconds = -1\n{HAND}", "seconds is -1: take more than 0"),
        ("seconds = 1\nseed = 2\n[[grid]]\n", "unknown field seed: the nearest one is seeds"),
        (f"seconds = 1\nseeds = 0\n{HAND}", "seeds is 0: take a number"),
        (f"seconds = 1\nseeds = [3, 3]\n{HAND}", "a list of different ones"),
        (f"seconds = 1\nseeds = 'a'\n{HAND}", "like 5 or [1, 2], not 'a'"),
        (f"seconds = 1\nseeds = 100001\n{HAND}", "100001 runs are too many"),
        ("seconds = 1\ngrid = 5\n", "grid must be tables [[grid]]"),
        (f"{GRID}hand = []\n", "grid 1: hand is an empty list: give it a value"),
        (f"{GRID}hand = ['direct']\n[[grid]]\nradio = ['gio']\n", "grid 2, radio = gio: "),
        (f"{GRID}uplink_video.cap_kbp = [5]\n", f"grid 1, uplink_video.cap_kbp = 5: {UNKNOWN}"),
        (f"{GRID}uplink_video.cap_kbps = [900]\n", "uplink_video.cap_kbps = 900: "),
        (f"{GRID}cameras = [5]\n", "cameras must be a list of texts"),
        (f"{GRID}hand.x = ['a']\n", "so there is no hand.x"),
        (f"{GRID}radio = ['geo']\nradio_delay_ms = [5]\n", "radio geo has a delay of its own"),
        (f"seconds = 1\n{HAND}[plot]\ny = 'vidio'\n", "plot.y is 'vidio': take one of"),
        (f"seconds = 1\n{HAND}[plot]\nx = 'y'\n", "plot.x is 'y': take one"),
    ],
)
def test_a_mistake_is_told_in_one_line(tmp_path, text, told):
    with pytest.raises(ConfigError) as raised:
        sweep_of(tmp_path, text)
    line = str(raised.value)
    assert told in line and "mine.toml" in line
    assert "\n" not in line
