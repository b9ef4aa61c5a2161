"""A recording as a LeRobot data set (format v3.0), for learning from demonstrations. A shell.

The format: docs.huggingface.co, "LeRobotDataset v3.0". Written by PyAV and pyarrow, so no PyTorch
is needed.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import av
import cv2
import numpy as np
from numpy.typing import NDArray

from kontur_av.clock import NS_PER_S
from kontur_av.codecs.decoder import DecodedPicture, VideoDecoder
from kontur_av.errors import ConfigError, ProtocolError
from kontur_av.media import I420, empty_picture
from pipelines.hand.haptic_trace import LATER_FIELDS, axis_columns, places_of
from pipelines.recording.channels import RECEIVED, SENT
from pipelines.recording.export.columns import Columns
from pipelines.recording.export.films import FilmUnit, FilmUnits
from pipelines.recording.export.tables import (
    NEAR_NS,
    TASK_CHANNELS,
    Placed,
    Run,
    TableCollector,
    TaskRuns,
    place_pictures,
    row_instants,
    usual_fps,
)
from pipelines.recording.joined import JoinedMessage, JoinedRecording
from pipelines.recording.recorded_messages import HAPTIC_SAMPLES, PARAMETERS, VIDEO
from pipelines.recording.recording_file import Outputs

if TYPE_CHECKING:
    import pyarrow as pa

_METADATA, _CAMERA = "/facts", "/camera/"
_STREAM = ("/uplink_video/" + SENT, "/uplink_video/" + RECEIVED)
STATE, FORCE, ACTION = "observation.state", "observation.force", "action"
#: Fields of a cycle beside place, force and credit, of the robot.
MORE = "observation.more"
#: A camera that has no picture for longer, while the stream carries it, is left out.
_LONGEST_GAP_NS = 2 * NS_PER_S
#: LeRobot keeps times as float32. So a longer run becomes several episodes.
_LONGEST_NS = 1800 * NS_PER_S
_FILES_A_CHUNK = 1000
#: As near to the decoded pictures as eyes can see; every second one can be jumped to.
_CODER = {"crf": "12", "g": "2", "bf": "0", "preset": "veryfast"}
_SAMPLED_PICTURES = 100
_QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
_INDEX = ("frame_index", "episode_index", "index", "task_index")

#: Columns of each table in front of its values.
_INSTANT_COLUMNS = len(("time_s", "session_ns"))

_Stats = dict[str, NDArray[Any]]


def check_packages() -> None:
    """Raise ConfigError if the package of the extra `lerobot` is not installed."""
    if find_spec("pyarrow") is None:
        raise ConfigError("--lerobot needs pyarrow: pip install 'kontur-av[lerobot]'")


class LeRobotExport:
    """A data set in a directory of its own. Rows are as `tables` says.

    State and force are those of the robot's newest cycle that is not after the capture of the row's
    picture; where that is repeated, not after the row's instant. The action is the handle's
    position in the newest sample on which the robot had acted by then.

    Call `begin`, then `handle_message` for each message, then `end`. fps: rows a second; None: the
    rate of the pictures. Raises ConfigError for a recording without pictures of the robot.
    """

    def __init__(self, directory: Path, recording: JoinedRecording, *, fps: int | None) -> None:
        if directory.exists() and (not directory.is_dir() or any(directory.iterdir())):
            raise ConfigError(f"{directory} exists: give a directory that is new or empty")
        if fps is not None and not 1 <= fps <= 1000:
            raise ConfigError(f"--fps {fps}: give 1 to 1000 rows a second")
        channels = recording.schemas
        stream = next((topic for topic in _STREAM if topic in channels), None)
        if stream is None:
            raise ConfigError("the recording has no pictures of the robot (/uplink_video/sent)")
        videos = [topic for topic, schema in channels.items() if schema == VIDEO.full_name]
        cameras = [topic for topic in videos if topic.startswith(_CAMERA)]
        self._cameras = [
            _Camera(topic, with_metadata=f"{topic}{_METADATA}" in channels)
            for topic in (stream, *sorted(cameras))
        ]
        self._takers = {topic: camera for camera in self._cameras for topic in camera.topics}
        self._directory, self._recording, self._fps = directory, recording, fps
        self._haptics = TableCollector(recording.begin_ns)
        self._parameters = TableCollector(recording.begin_ns)
        self._tasks = TaskRuns()
        self._outputs: Outputs | None = None
        self._lines: list[str] = []

    @property
    def paths(self) -> list[Path]:
        return [self._directory / "meta/info.json"]

    def begin(self, outputs: Outputs) -> None:
        outputs.make_directory(self._directory)
        self._outputs = outputs

    def handle_message(self, message: JoinedMessage) -> None:
        if (camera := self._takers.get(message.topic)) is not None:
            camera.handle_message(message)
        elif message.schema == HAPTIC_SAMPLES.full_name:
            self._haptics.handle_message(message)
        elif message.schema == PARAMETERS.full_name:
            self._parameters.handle_message(message)
        elif message.topic in TASK_CHANNELS:
            self._tasks.handle_message(message)

    def end(self) -> None:
        """Write the data set; ConfigError if it would have no row."""
        for camera in self._cameras:
            camera.end()
        hand = _Hand(self._haptics.tables(), self._recording.begin_ns)
        leading = self._cameras[0]
        if not len(leading.captures_ns):
            raise ConfigError(f"no picture of {leading.topic} can be decoded")
        fps = usual_fps(leading.captures_ns) if self._fps is None else self._fps
        cameras = [leading, *self._gapless(self._cameras[1:], leading.captures_ns)]
        begin_ns = max(hand.begin_ns, *(one.captures_ns[0] for one in cameras))
        metadata = self._recording.metadata
        setup = metadata.setup if metadata is not None and metadata.setup else "telepresence"
        runs = self._tasks.runs() or [Run(setup, begin_ns, None, "")]
        parameters = _Parameters(self._parameters.tables())
        writing = _Writing(self._directory, self._outputs, cameras, hand, parameters, fps, setup)
        for run in runs:
            writing.add_run(run, begin_ns)
        if not writing.episodes:
            raise ConfigError("no run of a task has a row with picture and hand")
        writing.end()
        self._lines += writing.lines()

    def lines(self) -> list[str]:
        return self._lines

    def _gapless(
        self, cameras: Sequence["_Camera"], leading_ns: NDArray[np.int64]
    ) -> Iterator["_Camera"]:
        for camera in cameras:
            marks = np.concatenate(([leading_ns[0]], camera.captures_ns, [leading_ns[-1]]))
            gap_ns = int(np.diff(marks).max())
            if len(camera.captures_ns) and gap_ns <= _LONGEST_GAP_NS:
                yield camera
            else:
                self._lines.append(
                    f"{camera.topic}: left out, without a picture for {gap_ns / NS_PER_S:.1f} s"
                )


class _Camera:
    """The pictures of a channel. They are decoded twice: first to know which there are."""

    def __init__(self, topic: str, *, with_metadata: bool) -> None:
        self.topic = topic
        name = topic.removeprefix(_CAMERA).strip("/").split("/")[0]
        self.key, self.instant_key = f"observation.images.{name}", f"capture_ns.{name}"
        self.topics = [topic, f"{topic}{_METADATA}"] if with_metadata else [topic]
        self.captures_ns: NDArray[np.int64] = np.zeros(0, np.int64)
        self.size = 0, 0
        self.unreadable = 0
        self._film = FilmUnits(with_metadata=with_metadata)
        self._units: list[FilmUnit] = []

    def handle_message(self, message: JoinedMessage) -> None:
        metadata = message.topic != self.topic
        take = self._film.handle_capabilities if metadata else self._film.handle_picture
        try:
            self._units.extend(take(message))
        except ProtocolError:
            self.unreadable += 1

    def end(self) -> None:
        self._units.extend(self._film.handle_end())
        found = [(at_ns, one.width, one.height) for at_ns, one in self._decoded()]
        if found:
            # One that was dated late by its arrival does not step back.
            self.captures_ns = np.maximum.accumulate(np.array([one[0] for one in found], np.int64))
            self.size = max(one[1] for one in found), max(one[2] for one in found)

    def pictures(self) -> Iterator[DecodedPicture]:
        """The pictures of `captures_ns`. Each is valid until the next one."""
        return (picture for _, picture in self._decoded())

    def _decoded(self) -> Iterator[tuple[int, DecodedPicture]]:
        decoder = VideoDecoder(self._units[0].codec if self._units else "h264")
        for data, session_ns, _ in self._units:
            for picture in decoder.decode(data, 0):
                yield session_ns, picture


class _Hand:
    """State, force and action at an instant. begin_ns: from which on all are known."""

    def __init__(self, tables: Mapping[str, Columns], origin_ns: int) -> None:
        robot, joystick = tables.get("haptic_up"), tables.get("haptic_down")
        if robot is None or joystick is None:
            end = "robot (/haptic/up/sent)" if robot is None else "joystick (/haptic/down/sent)"
            raise ConfigError(f"the recording has no cycles of the {end}: record both ends")
        self._origin_ns = origin_ns
        self._cycles_ns = np.asarray(robot["session_ns"])
        acted_s = np.asarray(joystick["received_s"])
        order = np.argsort(acted_s, kind="stable")
        order = order[: int(np.isfinite(acted_s).sum())]
        if not len(order):
            raise ConfigError("the robot acted on no sample of the joystick in this recording")
        self._acted_s = acted_s[order]
        places = places_of(robot)
        self.names = {STATE: places, FORCE: [axis_columns(place)[1] for place in places]}
        if later := [each.name for each in LATER_FIELDS]:
            self.names[MORE] = later
        self._values = {key: _matrix(robot, names) for key, names in self.names.items()}
        self.names[ACTION] = places
        self._values[ACTION] = _matrix(joystick, places)[order]
        acted_ns = origin_ns + round(self._acted_s[0] * NS_PER_S)
        self.begin_ns = max(int(self._cycles_ns[0]), acted_ns)
        self.end_ns = int(self._cycles_ns[-1])

    def at(self, instants_ns: NDArray[np.int64]) -> tuple[dict[str, NDArray[np.float32]], int]:
        """Values at instants from `begin_ns` on, and for how many the cycle is older than 20 ms."""
        cycle = np.searchsorted(self._cycles_ns, instants_ns, side="right") - 1
        instants_s = (instants_ns - self._origin_ns) / NS_PER_S
        acted = np.searchsorted(self._acted_s, instants_s, side="right") - 1
        found = {
            key: values[np.maximum(acted if key == ACTION else cycle, 0)]
            for key, values in self._values.items()
        }
        old = int((instants_ns - self._cycles_ns[np.maximum(cycle, 0)] > NEAR_NS).sum())
        return found, old


def _matrix(columns: Columns, names: Sequence[str]) -> NDArray[np.float32]:
    return np.stack([np.asarray(columns[name], np.float32) for name in names], axis=1)


class _Colours:
    """Sampled pictures as a histogram for each of red, green and blue: (3, 256)."""

    def __init__(self) -> None:
        self.counts = np.zeros((3, 256), np.int64)
        self.pictures = 0

    def add(self, picture: I420) -> None:
        colours = cv2.cvtColor(picture, cv2.COLOR_YUV2RGB_I420)
        for channel in range(3):
            self.counts[channel] += np.bincount(colours[..., channel].ravel(), minlength=256)
        self.pictures += 1

    def stats(self) -> _Stats:
        levels = np.arange(256) / 255
        share = self.counts / self.counts.sum(axis=1, keepdims=True)
        mean = share @ levels
        summed = share.cumsum(axis=1)
        seen = self.counts > 0
        values = {
            "min": levels[seen.argmax(axis=1)],
            "max": levels[255 - seen[:, ::-1].argmax(axis=1)],
            "mean": mean,
            "std": np.sqrt(np.maximum(share @ levels**2 - mean**2, 0)),
        } | {name: levels[(summed >= q).argmax(axis=1)] for name, q in _QUANTILES.items()}
        shaped = {name: value.reshape(3, 1, 1) for name, value in values.items()}
        return shaped | {"count": np.array([self.pictures])}


class _Parameters:
    """What components have reported last, at an instant: a vector of numbers each, and texts."""

    def __init__(self, tables: Mapping[str, Columns]) -> None:
        self.names: dict[str, list[str]] = {}
        #: By feature: of each of its columns, the instants of its values and these.
        self._told: dict[str, list[tuple[NDArray[np.int64], NDArray[Any]]]] = {}
        for table, columns in tables.items():
            own, _, way = table.rpartition("_")
            if way == RECEIVED and f"{own}_{SENT}" in tables:
                continue
            at_ns = np.asarray(columns["session_ns"])
            for name, column in [*columns.items()][_INSTANT_COLUMNS:]:
                text = isinstance(column, list)
                values = np.asarray(column, object if text else np.float64)
                known = values != "" if text else np.isfinite(values)
                key = own.replace("_", ".", 1) + (f".{name}" if text else "")
                self.names.setdefault(key, []).append(name)
                self._told.setdefault(key, []).append((at_ns[known], values[known]))

    def at(self, instants_ns: NDArray[np.int64]) -> dict[str, NDArray[Any]]:
        """Values by feature, (rows, columns) or texts (rows,); NaN or "" before the first."""
        found = {}
        for key, columns in self._told.items():
            text = columns[0][1].dtype == object
            rows = [
                np.concatenate(([""] if text else [np.nan], values))[
                    np.searchsorted(at_ns, instants_ns, side="right")
                ]
                for at_ns, values in columns
            ]
            found[key] = rows[0].astype(object) if text else np.stack(rows, axis=1)
        return found


def _all_stats(rows: Mapping[str, NDArray[Any]]) -> dict[str, _Stats]:
    return {key: _stats(value) for key, value in rows.items() if value.dtype != object}


def _stats(values: NDArray[Any]) -> _Stats:
    """Of rows: of each component. Rows with a value that is not known yet do not count."""
    rows = values.reshape(len(values), -1).astype(np.float64)
    rows = rows[np.isfinite(rows).all(axis=1)]
    if not len(rows):
        rows = np.zeros((1, values.size // len(values)))
    found = {
        "min": rows.min(axis=0),
        "max": rows.max(axis=0),
        "mean": rows.mean(axis=0),
        "std": rows.std(axis=0),
    }
    quantiles = np.quantile(rows, [*_QUANTILES.values()], axis=0)
    return found | dict(zip(_QUANTILES, quantiles, strict=True)) | {"count": np.array([len(rows)])}


class _Writing:
    """Writes the episodes one after the other, then all that is told of them."""

    def __init__(
        self,
        directory: Path,
        outputs: Outputs | None,
        cameras: Sequence[_Camera],
        hand: _Hand,
        parameters: "_Parameters",
        fps: int,
        setup: str,
    ) -> None:
        assert outputs is not None
        self._directory, self._outputs = directory, outputs
        self._cameras, self._hand, self._fps, self._setup = cameras, hand, fps, setup
        self._parameters = parameters
        self.episodes: list[dict[str, object]] = []
        self._tasks: list[str] = []
        self._rows: list[dict[str, NDArray[Any]]] = []
        self._all_colours = {camera.key: _Colours() for camera in cameras}
        #: Of each camera: its decoder goes on from one episode to the next.
        self._films = {camera.key: _Film(camera) for camera in cameras}
        self._repeated = {camera.key: 0 for camera in cameras}
        self._left_out = {camera.key: 0 for camera in cameras}
        self._old = self._total = 0

    def add_run(self, run: Run, begin_ns: int) -> None:
        """Write a run as one episode, or several if it is long."""
        leading = self._cameras[0].captures_ns
        last_ns = min(self._hand.end_ns, int(leading[-1]))
        end_ns = last_ns if run.end_ns is None else min(run.end_ns, last_ns)
        at_ns = max(run.begin_ns, begin_ns)
        while (first := int(np.searchsorted(leading, at_ns))) < len(leading):
            first_ns = int(leading[first])
            if first_ns > end_ns:
                break
            self._add(run, row_instants(first_ns, min(end_ns, first_ns + _LONGEST_NS), self._fps))
            at_ns = first_ns + _LONGEST_NS + 1

    def _add(self, run: Run, instants_ns: NDArray[np.int64]) -> None:
        number, count = len(self.episodes), len(instants_ns)
        placed = {
            camera.key: place_pictures(camera.captures_ns, instants_ns, self._fps)
            for camera in self._cameras
        }
        leading = placed[self._cameras[0].key]
        captured = self._cameras[0].captures_ns[leading.pictures]
        values, old = self._hand.at(np.where(leading.own, captured, instants_ns))
        self._old += old
        if run.task not in self._tasks:
            self._tasks.append(run.task)
        task = self._tasks.index(run.task)
        rows: dict[str, NDArray[Any]] = dict(values)
        rows |= self._parameters.at(instants_ns)
        for one in self._cameras:
            rows[one.instant_key] = one.captures_ns[placed[one.key].pictures]
        rows["timestamp"] = (np.arange(count) / self._fps).astype(np.float32)
        indices = (np.arange(count), number, self._total + np.arange(count), task)
        for name, index in zip(_INDEX, indices, strict=True):
            rows[name] = np.broadcast_to(np.asarray(index, np.int64), count)
        episode: dict[str, object] = {
            "episode_index": number,
            "tasks": [run.task],
            "length": count,
            "result": run.result,
            "data/chunk_index": 0,
            "data/file_index": 0,
            "dataset_from_index": self._total,
            "dataset_to_index": self._total + count,
            "meta/episodes/chunk_index": 0,
            "meta/episodes/file_index": 0,
        }
        stats = _all_stats(rows)
        for one in self._cameras:
            colours = self._write_film(one, placed[one.key], number)
            stats[one.key] = colours.stats()
            self._all_colours[one.key].counts += colours.counts
            self._all_colours[one.key].pictures += colours.pictures
            chunk, file = divmod(number, _FILES_A_CHUNK)
            told = (chunk, file, 0.0, count / self._fps)
            names = ("chunk_index", "file_index", "from_timestamp", "to_timestamp")
            episode |= {f"videos/{one.key}/{key}": v for key, v in zip(names, told, strict=True)}
        for key, found in stats.items():
            episode |= {f"stats/{key}/{name}": value.tolist() for name, value in found.items()}
        self.episodes.append(episode)
        self._rows.append(rows)
        self._total += count

    def _write_film(self, camera: _Camera, placed: Placed, number: int) -> _Colours:
        self._repeated[camera.key] += int((~placed.own).sum())
        self._left_out[camera.key] += placed.left_out
        colours, step = _Colours(), -(-len(placed.pictures) // _SAMPLED_PICTURES)
        chunk, file = divmod(number, _FILES_A_CHUNK)
        path = self._file(f"videos/{camera.key}/chunk-{chunk:03d}/file-{file:03d}.mp4")
        with av.open(str(path), "w", format="mp4") as container:
            stream = container.add_stream("libx264", rate=self._fps, options=_CODER)
            stream.width, stream.height = camera.size
            stream.pix_fmt = "yuv420p"
            for row, wanted in enumerate(placed.pictures):
                picture = self._films[camera.key].picture(int(wanted))
                if row % step == 0:
                    colours.add(picture)
                frame = av.VideoFrame.from_ndarray(picture, format="yuv420p")
                frame.pts = row
                container.mux(stream.encode(frame))
            container.mux(stream.encode(None))
        return colours

    def end(self) -> None:
        import pyarrow as pa

        rows = {key: np.concatenate([row[key] for row in self._rows]) for key in self._rows[0]}
        stats = _all_stats(rows)
        stats |= {key: colours.stats() for key, colours in self._all_colours.items()}
        columns = {
            key: pa.FixedSizeListArray.from_arrays(pa.array(value.ravel()), value.shape[1])
            if value.ndim == 2 and value.shape[1] > 1
            else pa.array(value.ravel())
            for key, value in rows.items()
        }
        self._table("data/chunk-000/file-000.parquet", pa.table(columns))
        self._table("meta/episodes/chunk-000/file-000.parquet", pa.Table.from_pylist(self.episodes))
        self._table("meta/tasks.parquet", _tasks_table(self._tasks))
        plain = {
            key: {name: value.tolist() for name, value in found.items()}
            for key, found in stats.items()
        }
        self._file("meta/stats.json").write_text(json.dumps(plain, indent=4))
        self._file("meta/info.json").write_text(json.dumps(self._info(rows), indent=4))

    def lines(self) -> list[str]:
        told = [
            f"{self._directory}: {self._total} rows in {len(self.episodes)} episodes, "
            f"{self._fps} rows a second"
        ]
        for camera in self._cameras:
            told.append(
                f"{camera.key}: {self._repeated[camera.key]} rows repeat a picture, "
                f"{self._left_out[camera.key]} pictures left out for a newer one of the same row"
            )
            if camera.unreadable:
                told.append(f"{camera.topic}: {camera.unreadable} messages are no pictures")
        if self._old:
            told.append(f"{self._old} rows have a cycle of the robot that is older than 20 ms")
        return told

    def _info(self, rows: Mapping[str, NDArray[Any]]) -> dict[str, object]:
        features: dict[str, object] = {}
        for camera in self._cameras:
            width, height = camera.size
            told = {"height": height, "width": width, "codec": "h264", "pix_fmt": "yuv420p"}
            told |= {"is_depth_map": False, "fps": self._fps, "channels": 3}
            features[camera.key] = {
                "dtype": "video",
                "shape": [height, width, 3],
                "names": ["height", "width", "channels"],
                "info": {f"video.{name}": value for name, value in told.items()}
                | {"has_audio": False},
            }
        for key, value in rows.items():
            width = value.shape[1] if value.ndim == 2 else 1
            features[key] = {
                "dtype": "string" if value.dtype == object else str(value.dtype),
                "shape": [width],
                "names": self._hand.names.get(key) or self._parameters.names.get(key),
            }
        return {
            "codebase_version": "v3.0",
            "robot_type": self._setup,
            "total_episodes": len(self.episodes),
            "total_frames": self._total,
            "total_tasks": len(self._tasks),
            "chunks_size": _FILES_A_CHUNK,
            "data_files_size_in_mb": 100,
            "video_files_size_in_mb": 200,
            "fps": self._fps,
            "splits": {"train": f"0:{len(self.episodes)}"},
            "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
            "video_path": "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4",
            "features": features,
        }

    def _table(self, name: str, table: "pa.Table") -> None:
        from pyarrow import parquet

        parquet.write_table(table, self._file(name))

    def _file(self, name: str) -> Path:
        """Make the folders of a file; where to write it."""
        path = self._directory / name
        for folder in reversed(path.relative_to(self._directory).parents[:-1]):
            self._outputs.make_directory(self._directory / folder)
        return self._outputs.unfinished(path)


class _Film:
    """The pictures of a camera one after the other, all of one size."""

    def __init__(self, camera: _Camera) -> None:
        self._pictures = camera.pictures()
        self._number = -1
        self._newest = empty_picture(*camera.size)

    def picture(self, number: int) -> I420:
        """Return a picture, by a number that never falls; valid until the next call."""
        picture = None
        while self._number < number:
            picture = next(self._pictures)
            self._number += 1
        if picture is not None:
            picture.scale_into(self._newest)
        return self._newest


def _tasks_table(tasks: Sequence[str]) -> "pa.Table":
    """The tasks with their texts as the index of pandas, as LeRobot wants."""
    import pyarrow as pa

    index = "__index_level_0__"
    text = {"pandas_type": "unicode", "numpy_type": "object", "metadata": None}
    told = {
        "index_columns": [index],
        "column_indexes": [],
        "columns": [
            {"name": "task_index", "field_name": "task_index"}
            | {"pandas_type": "int64", "numpy_type": "int64", "metadata": None},
            {"name": None, "field_name": index} | text,
        ],
        "creator": {"library": "pyarrow", "version": pa.__version__},
        "pandas_version": "2.0.0",
    }
    table = pa.table({"task_index": np.arange(len(tasks)), index: list(tasks)})
    return table.replace_schema_metadata({"pandas": json.dumps(told)})
