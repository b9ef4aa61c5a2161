"""`kontur-av export` writes all that was asked for, or refuses in one line and leaves nothing."""

import csv
import shutil

import h5py
import numpy as np
import pytest
from mcap.writer import Writer
from scipy.io import loadmat
from synthetic_recording import write_recording

from pipelines.cli import main
from pipelines.recording import facts
from pipelines.recording.export import table_files


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    return write_recording(tmp_path_factory.mktemp("written") / "a.mcap", parts=2, link_frames=True)


@pytest.fixture
def recording(written, tmp_path):
    """The first of two parts."""
    for path in written.paths:
        shutil.copy(path, tmp_path)
    return tmp_path / "a.mcap"


def refused(capsys, *words):
    """The one line with which a command is refused."""
    assert main(["export", *(str(word) for word in words)]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("kontur-av: ")
    assert err.count("\n") == 1
    return err


def names(directory):
    return sorted(path.name for path in directory.iterdir())


def test_a_matlab_file_has_the_tables_and_where_they_come_from(recording, written, capsys):
    out = recording.with_name("out.mat")
    assert main(["export", str(recording), "--mat", str(out)]) == 0
    assert f"{out}: 19 tables" in capsys.readouterr().out
    found = loadmat(out, simplify_cells=True)
    assert found["recording"]["session"] == "kontur-1"
    assert found["recording"]["parts"] == 2
    assert found["recording"]["begin_wall_ns"] == written.facts.wall_ns
    cycles = written.haptics["/haptic/up/sent"]
    assert found["haptic_up"]["fx_n"].tolist() == cycles["fx_n"].tolist()
    assert loadmat(out)["haptic_up"]["time_s"][0, 0].shape == (len(cycles), 1)
    assert list(found["events"]["what"]) == ["link", "touch", "camera", "touch", "touch"]
    assert names(recording.parent) == ["a-2.mcap", "a.mcap", "out.mat"]


def test_what_is_too_long_for_the_older_matlab_format_is_written_in_the_newer(
    recording, monkeypatch, capsys
):
    out = recording.with_name("out.mat")
    assert main(["export", str(recording), "--mat", str(out)]) == 0
    old = loadmat(out)
    # A table of 3000 cycles of 70 octets is longer.
    monkeypatch.setattr(table_files, "MOST_V5_OCTETS", 200_000)
    assert main(["export", str(recording), "--mat", str(out), "--overwrite"]) == 0
    assert "MATLAB v7.3" in capsys.readouterr().out
    assert out.read_bytes().startswith(b"MATLAB 7.3 MAT-file")
    with h5py.File(out) as file:

        def text(data):
            assert data.attrs["MATLAB_class"] == b"char"
            return np.asarray(data).tobytes().decode("utf-16-le")

        assert text(file["recording/session"]) == "kontur-1"
        for name, table in file.items():
            if name == "#refs#":
                continue
            assert table.attrs["MATLAB_class"] == b"struct"
            fields = [field.tobytes().decode() for field in table.attrs["MATLAB_fields"]]
            assert fields == list(old[name].dtype.names)
            for field, data in table.items():
                kind = data.attrs["MATLAB_class"]
                before = old[name][field][0, 0]
                if kind == b"cell":
                    texts = [text(file[each]) for each in data[0]]
                    assert texts == [cell[0] if cell.size else "" for cell in before[:, 0]]
                elif kind != b"char":
                    assert np.array_equal(data, before.T, equal_nan=data.dtype.kind == "f")


def test_there_is_a_csv_file_for_each_channel_with_units_in_its_headings(recording, written):
    directory = recording.with_name("csv")
    assert main(["export", str(recording), "--csv", str(directory)]) == 0
    assert len(names(directory)) == len(written.told)
    with (directory / "haptic_up_sent.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    cycles = written.haptics["/haptic/up/sent"]
    assert len(rows) == len(cycles)
    assert [float(row["fx_n"]) for row in rows] == pytest.approx(cycles["fx_n"].tolist(), rel=1e-6)
    assert [int(row["session_ns"]) for row in rows] == cycles["time_ns"].tolist()
    with (directory / "link_uplink_frames_sent.csv").open(newline="") as file:
        assert {row["data_hex"] for row in csv.DictReader(file)} == {"01" * 32}
    with (directory / "link_uplink_sent.csv").open(newline="") as file:
        assert [int(row["carried_video_octets"]) for row in csv.DictReader(file)] == [
            1000 * number for number in range(30)
        ]


def test_a_torn_recording_is_exported_as_far_as_it_can_be_read(recording, capsys):
    torn = recording.with_name("torn.mcap")
    torn.write_bytes(recording.read_bytes()[:-9000])
    out = recording.with_name("out.mat")
    assert main(["export", str(torn), "--mat", str(out)]) == 0
    assert f"{torn} is torn or damaged: " in capsys.readouterr().out
    assert len(loadmat(out, simplify_cells=True)["haptic_up"]["time_s"]) > 500


def test_a_copy_of_a_part_is_left_out_of_the_export(recording, capsys):
    shutil.copy(recording, recording.with_name("a-2.mcap"))
    out = recording.with_name("out.mat")
    assert main(["export", str(recording), "--mat", str(out)]) == 0
    assert "a-2.mcap is left out: part 1 is there already" in capsys.readouterr().err
    assert loadmat(out, simplify_cells=True)["recording"]["parts"] == 1


def test_what_exists_is_replaced_only_if_told_to(recording, capsys):
    out, directory = recording.with_name("out.mat"), recording.with_name("csv")
    directory.mkdir()
    (directory / "events.csv").write_text("precious")
    words = (recording, "--mat", out, "--csv", directory)
    assert "events.csv exists: give another name, or --overwrite" in refused(capsys, *words)
    assert (directory / "events.csv").read_text() == "precious"
    assert names(directory) == ["events.csv"]
    assert not out.exists()
    assert main(["export", *map(str, words), "--overwrite"]) == 0
    assert (directory / "events.csv").read_text().startswith("time_s,")
    capsys.readouterr()
    before = recording.read_bytes()
    assert "is the recording itself" in refused(
        capsys, recording, "--mat", recording, "--overwrite"
    )
    assert recording.read_bytes() == before


def test_an_export_that_fails_leaves_nothing(recording, capsys, monkeypatch):
    def full_disk(*_args, **_options):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(table_files, "write_v5", full_disk)
    words = (
        recording,
        "--mat",
        recording.with_name("out.mat"),
        "--csv",
        recording.with_name("csv"),
    )
    assert "No space left on device" in refused(capsys, *words)
    assert names(recording.parent) == ["a-2.mcap", "a.mcap"]


def test_nothing_is_written_where_nothing_can_be(recording, capsys):
    assert "give at least one of" in refused(capsys, recording)
    assert "give --mat OUT.mat, too" in refused(capsys, recording, "--csv", "x", "--mat73")
    assert "cannot be written" in refused(capsys, recording, "--mat", "/nowhere/out.mat")
    assert "is no directory" in refused(capsys, recording, "--csv", recording)
    assert "cannot be made" in refused(capsys, recording, "--csv", "/proc/nowhere")
    assert "cannot be written" in refused(capsys, recording, "--mat", "/proc/out.mat")
    assert "is a directory" in refused(capsys, recording, "--mat", recording.parent)


def test_a_missing_package_is_one_line_that_names_the_mend(recording, capsys, monkeypatch):
    monkeypatch.setattr(table_files, "find_spec", lambda name: None)
    line = refused(capsys, recording, "--mat", recording.with_name("out.mat"))
    assert "pip install 'kontur-av[export]'" in line


def other_program(path):
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(library="other")
        number = writer.register_channel("/x", "json", 0)
        writer.add_message(number, log_time=0, publish_time=0, data=b"{}")
        writer.finish()


def test_what_is_no_recording_of_ours_is_refused(tmp_path, monkeypatch, capsys):
    out = tmp_path / "out.mat"
    alien, foreign = tmp_path / "alien.mcap", tmp_path / "foreign.mcap"
    alien.write_bytes(b"hello, world")
    other_program(foreign)
    newer, missing = tmp_path / "newer.mcap", tmp_path / "missing.mcap"
    with monkeypatch.context() as patch:
        patch.setattr(facts, "FORMAT", facts.FORMAT + 1)
        write_recording(newer, seconds=1)
    assert "is not an MCAP file" in refused(capsys, alien, "--mat", out)
    assert "written by other, not by kontur-av" in refused(capsys, foreign, "--mat", out)
    assert "install a newer one" in refused(capsys, newer, "--mat", out)
    assert "cannot be read" in refused(capsys, missing, "--mat", out)
    assert not out.exists()
