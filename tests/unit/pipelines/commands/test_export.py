"""`kontur-av export` writes all that was asked for, or leaves nothing."""

import csv
import json
import shutil

import h5py
import numpy as np
import pytest
from scipy.io import loadmat
from synthetic_recording import BEGIN_NS, WALL_OFFSET_NS, S, Told, write_recording

from kontur_av.media import CaptureStamp
from pipelines.cli import main
from pipelines.recording.channels import sources_of
from pipelines.recording.export import table_files
from pipelines.recording.session_messages import Instants, SessionMessages
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.table import topology_of
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary
from telepresence.tmtc.pus.packets import Telemetry, pack_packet
from telepresence.tmtc.telemetry_source import (
    Component,
    TelemetryParameter,
    TelemetrySource,
    application_of,
    with_components,
)

pq = pytest.importorskip("pyarrow.parquet", reason="pyarrow: pip install -e '.[full]'")


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    return write_recording(tmp_path_factory.mktemp("written") / "a.mcap", parts=2, link_frames=True)


@pytest.fixture
def recording(written, tmp_path):
    """The first of two parts."""
    for path in written.paths:
        shutil.copy(path, tmp_path)
    return tmp_path / "a.mcap"


def export(recording, *words):
    return main(["export", *map(str, (recording, *words))])


def names(directory):
    return sorted(path.name for path in directory.iterdir())


def text_of(data):
    assert data.attrs["MATLAB_class"] == b"char"
    return np.asarray(data).tobytes().decode("utf-16-le")


def test_a_matlab_file_has_the_tables_and_where_they_come_from(
    recording, written, capsys, monkeypatch
):
    out = recording.with_name("out.mat")
    assert export(recording, "--mat", out) == 0
    assert f"{out}: 19 tables" in capsys.readouterr().out
    found = loadmat(out, simplify_cells=True)
    assert (found["recording"]["session"], found["recording"]["parts"]) == ("kontur-1", 2)
    assert found["recording"]["begin_wall_ns"] == written.capabilities.wall_ns
    cycles = written.haptics["/haptic/up/sent"]
    assert found["haptic_up"]["fx_n"].tolist() == cycles["fx_n"].tolist()
    old = loadmat(out)
    assert old["haptic_up"]["time_s"][0, 0].shape == (len(cycles), 1)
    assert list(found["events"]["what"]) == ["link", "touch", "camera", "touch", "touch"]
    assert names(recording.parent) == ["a-2.mcap", "a.mcap", "out.mat"]
    # What is too long for the older format is written in the newer. A table of 3000 cycles is.
    monkeypatch.setattr(table_files, "MOST_V5_OCTETS", 200_000)
    assert export(recording, "--mat", out, "--overwrite") == 0
    assert "MATLAB v7.3" in capsys.readouterr().out
    assert out.read_bytes().startswith(b"MATLAB 7.3 MAT-file")
    with h5py.File(out) as file:
        assert text_of(file["recording/session"]) == "kontur-1"
        for name, table in file.items():
            if name != "#refs#":
                assert_same_table(file, table, old[name])


def assert_same_table(file, table, old):
    assert table.attrs["MATLAB_class"] == b"struct"
    fields = [field.tobytes().decode() for field in table.attrs["MATLAB_fields"]]
    assert fields == list(old.dtype.names)
    for field, data in table.items():
        kind = data.attrs["MATLAB_class"]
        before = old[field][0, 0]
        if kind == b"cell":
            texts = [text_of(file[each]) for each in data[0]]
            assert texts == [cell[0] if cell.size else "" for cell in before[:, 0]]
        elif kind != b"char":
            assert np.array_equal(data, before.T, equal_nan=data.dtype.kind == "f")


def test_there_is_a_csv_file_for_each_channel_with_units_in_its_headings(recording, written):
    directory = recording.with_name("csv")

    def rows_of(name):
        with (directory / name).open(newline="") as file:
            return list(csv.DictReader(file))

    directory.mkdir()
    (directory / "events.csv").write_text("no longer precious")
    assert export(recording, "--csv", directory, "--overwrite") == 0
    assert (directory / "events.csv").read_text().startswith("time_s,")
    assert len(names(directory)) == len(written.told)
    rows, cycles = rows_of("haptic_up_sent.csv"), written.haptics["/haptic/up/sent"]
    assert len(rows) == len(cycles)
    assert [float(row["fx_n"]) for row in rows] == pytest.approx(cycles["fx_n"].tolist(), rel=1e-6)
    assert [int(row["session_ns"]) for row in rows] == cycles["time_ns"].tolist()
    frames = rows_of("link_uplink_frames_sent.csv")
    assert {row["data_hex"] for row in frames} == {"01" * 32}
    carried = [int(row["carried_video_octets"]) for row in rows_of("link_uplink_sent.csv")]
    assert carried == [1000 * number for number in range(30)]


def test_a_torn_recording_is_exported_as_far_as_it_can_be_read(recording, capsys):
    torn = recording.with_name("torn.mcap")
    torn.write_bytes(recording.read_bytes()[:-9000])
    out = recording.with_name("out.mat")
    assert export(torn, "--mat", out) == 0
    assert f"{torn} is torn or damaged: " in capsys.readouterr().out
    assert len(loadmat(out, simplify_cells=True)["haptic_up"]["time_s"]) > 500


@pytest.mark.parametrize(
    ("broken", "says"),
    [("write_v5", "No space left on device"), ("find_spec", "pip install 'kontur-av[export]'")],
)
def test_an_export_that_fails_leaves_nothing(recording, capsys, monkeypatch, broken, says):
    def full_disk(*_args, **_options):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(
        table_files, broken, full_disk if broken == "write_v5" else lambda name: None
    )
    words = ("--mat", recording.with_name("out.mat"), "--csv", recording.with_name("csv"))
    assert export(recording, *words) == 2
    assert says in capsys.readouterr().err
    assert names(recording.parent) == ["a-2.mcap", "a.mcap"]


class Oven(TelemetrySource):
    """A component with every type of a parameter, in reports of three kinds."""

    name = "oven"
    parameters = (
        TelemetryParameter(name="heat", unit="°C", period_s=1.0),
        TelemetryParameter(name="fans", type="u32", unit="1/min", period_s=1.0),
        TelemetryParameter(name="least", type="i8", period_s=1.0),
        TelemetryParameter(name="closed", type="bool", period_s=2.0),
        TelemetryParameter(name="mode", type="choice", choices=("idle", "bake"), period_s=2.0),
        TelemetryParameter(name="dish", type="text", size=8, period_s=None),
    )


#: By instant (s): service, subtype, and what is reported.
REPORTS = {
    0.5: (3, 25, 1, {"heat": 21.5, "fans": 2**32 - 1, "least": -128}),
    1.0: (3, 25, 2, {"closed": True, "mode": "bake"}),
    1.5: (20, 2, 1, {"dish": "pie"}),
    2.0: (3, 25, 1, {"heat": 180.25, "fans": 7, "least": 127}),
}
COLUMNS = ["heat_degc", "fans_1_min", "least", "closed", "mode", "dish"]


def test_parameters_of_a_component_are_columns_that_other_programs_read(tmp_path):
    component = Component("x:Oven", application_of(Oven(), 0x140))
    topology = topology_of(BUILT_IN["spacejustin"], components=(component,))
    dictionary = with_components(built_in_dictionary(), [component])
    messages, told = SessionMessages(WALL_OFFSET_NS, dictionary), []
    sources = {source.topic: source for source in sources_of(topology)}
    for count, (at_s, (service, subtype, number, values)) in enumerate(REPORTS.items()):
        table, at_ns = component.application, BEGIN_NS + round(at_s * S)
        packed = [(table.parameter(name), value) for name, value in values.items()]
        data = bytes([number]) + b"".join(
            (bytes([one.number]) if service == 20 else b"") + one.pack(value)
            for one, value in packed
        )
        octets = pack_packet(
            Telemetry(apid=0x140, count=count, service=service, subtype=subtype, data=data)
        )
        at = Instants(at_ns, at_ns)
        for topic in ("tm/ground/sent", "tm/space/received", "tm/ground/local"):
            stamp = CaptureStamp(at_ns, count, "tm")
            told += messages.of_sample(sources[topic], octets, stamp, at)
    more = [
        Told(one.channel, one.log_ns - WALL_OFFSET_NS, one.at.now_ns, one.sequence, one.data)
        for one in told
        if one.channel.startswith("/parameters")
    ]
    written = write_recording(tmp_path / "a.mcap", components=(component,), more=more)
    out, mat, rows = tmp_path / "csv", tmp_path / "a.mat", tmp_path / "set"
    asked = ("--csv", out, "--mat", mat, "--lerobot", rows, "--fps", 20)
    assert export(written.paths[0], *asked) == 0
    nan = np.nan
    expected = {
        "heat_degc": [21.5, nan, nan, 180.25],
        "fans_1_min": [2**32 - 1, nan, nan, 7],
        "least": [-128, nan, nan, 127],
        "closed": [nan, 1, nan, nan],
        "mode": ["", "bake", "", ""],
        "dish": ["", "", "pie", ""],
    }
    for way in ("sent", "received"):
        name = f"parameters_oven_{way}"
        read = np.genfromtxt(
            out / f"{name}.csv", delimiter=",", names=True, dtype=None, encoding="utf-8"
        )
        fields = loadmat(mat, squeeze_me=True)[name]
        assert list(read.dtype.names) == ["time_s", "session_ns", *COLUMNS]
        assert read["time_s"] == pytest.approx(list(REPORTS))
        for column, values in expected.items():
            texts = isinstance(values[0], str)
            found = [str(one) if len(one) else "" for one in fields[column].item()] if texts else 0
            assert (found or list(fields[column].item())) == pytest.approx(values, nan_ok=True)
            assert read[column].tolist() == pytest.approx(values, nan_ok=True)
    table = pq.read_table(rows / "data/chunk-000/file-000.parquet").to_pydict()
    features = json.loads((rows / "meta/info.json").read_text())["features"]
    assert features["parameters.oven"]["names"] == COLUMNS[:4]
    assert features["parameters.oven.mode"]["dtype"] == "string"
    assert table["parameters.oven"][-1] == [180.25, 7.0, 127.0, 1.0]
    assert {*table["parameters.oven.dish"]} == {"", "pie"}
    assert table["parameters.oven.mode"][-1] == "bake"
