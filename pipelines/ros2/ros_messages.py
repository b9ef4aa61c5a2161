"""The messages of ROS 2 that a session sends and takes, as CDR (OMG DDSI-RTPS 10.2). A core.

rosbags has the types of ROS 2, their hashes (REP-2016) and CDR. From Iron to Kilted these types
have the same hashes.
"""

from collections.abc import Iterable, Mapping
from math import cos, sin
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ProtocolError
from kontur_av.media import VideoCodec
from pipelines.hand.haptic_trace import DEAD_MAN, axis_columns, places_of
from pipelines.ros2.hand import DEAD_MAN_BUTTON, JoyMessage, Velocity
from pipelines.ros2.publications import DIAGNOSTICS, IMAGE, JOY, POSE, TEXT, TWIST, VIDEO, WRENCH

#: Foxglove's schema of a coded picture, which no release of ROS 2 brings along.
_VIDEO_FIELDS = "builtin_interfaces/Time timestamp\nstring frame_id\nuint8[] data\nstring format\n"
#: A message of the two topics that come in has 200 octets.
MOST_OCTETS: Final = 4096
#: Levels of `diagnostic_msgs/DiagnosticStatus`.
_WELL, _ERROR = 0, 2
_TURNED, _ROLLED = ("x", "y", "z"), ("roll", "pitch", "yaw")


class RosMessages:
    """Makes and reads messages. wall_offset_ns: wall time less the session's clock."""

    def __init__(self, wall_offset_ns: int) -> None:
        self._offset_ns = wall_offset_ns
        self._store = get_typestore(Stores.ROS2_JAZZY)
        self._store.register(get_types_from_msg(_VIDEO_FIELDS, VIDEO))

    def type_hash(self, name: str) -> str:
        return self._store.hash_rihs01(name)

    def image(self, jpeg: NDArray[np.uint8], name: str, session_ns: int) -> bytes:
        """Return a picture of a camera. jpeg: (octets,)."""
        return self._packed(IMAGE, header=self._header(name, session_ns), format="jpeg", data=jpeg)

    def video(self, unit: bytes, name: str, session_ns: int, codec: VideoCodec = "h264") -> bytes:
        """Return an access unit (Annex B) of a stream."""
        return self._packed(
            VIDEO,
            timestamp=self._time(session_ns),
            frame_id=name,
            data=np.frombuffer(unit, np.uint8),
            format=codec,
        )

    def text(self, text: str) -> bytes:
        return self._packed(TEXT, data=text)

    def pose(self, rows: NDArray[np.void], name: str) -> bytes:
        """Return the place in the last of `rows`, a haptic trace. Rotations are about fixed axes.

        The frame has x to the right, y up and z to the operator; m, from the workspace's middle.
        """
        row = rows[-1]
        x, y, z = (_value(row, f"{axis}_m") for axis in _TURNED)
        roll, pitch, yaw = (_value(row, f"{axis}_rad") / 2 for axis in _ROLLED)
        cr, sr, cp, sp, cy, sy = cos(roll), sin(roll), cos(pitch), sin(pitch), cos(yaw), sin(yaw)
        place = self._made("geometry_msgs/msg/Point", x=x, y=y, z=z)
        turned = self._made(
            "geometry_msgs/msg/Quaternion",
            x=sr * cp * cy - cr * sp * sy,
            y=cr * sp * cy + sr * cp * sy,
            z=cr * cp * sy - sr * sp * cy,
            w=cr * cp * cy + sr * sp * sy,
        )
        pose = self._made("geometry_msgs/msg/Pose", position=place, orientation=turned)
        return self._packed(POSE, header=self._header(name, int(row["time_ns"])), pose=pose)

    def twist(self, rows: NDArray[np.void], name: str) -> bytes:
        """Return the mean velocity (m/s, rad/s) between the first and the last of `rows`."""
        first, last = rows[0], rows[-1]
        seconds = int(last["time_ns"] - first["time_ns"]) / NS_PER_S

        def speed(field: str) -> float:
            return (_value(last, field) - _value(first, field)) / seconds if seconds else 0.0

        twist = self._made(
            "geometry_msgs/msg/Twist",
            linear=self._vector(speed(f"{axis}_m") for axis in _TURNED),
            angular=self._vector(speed(f"{axis}_rad") for axis in _ROLLED),
        )
        return self._packed(TWIST, header=self._header(name, int(last["time_ns"])), twist=twist)

    def wrench(self, rows: NDArray[np.void], name: str) -> bytes:
        """Return the force (N, N m) in the last of `rows`."""
        row = rows[-1]
        forces = (_value(row, axis_columns(f"{axis}_m")[1]) for axis in _TURNED)
        wrench = self._made(
            "geometry_msgs/msg/Wrench",
            force=self._vector(forces),
            torque=self._vector(_value(row, f"{axis}_n_m") for axis in _ROLLED),
        )
        return self._packed(WRENCH, header=self._header(name, int(row["time_ns"])), wrench=wrench)

    def number(self, rows: NDArray[np.void], field: str) -> bytes:
        """Return a field of the last of `rows`."""
        return self._packed("std_msgs/msg/Float32", data=float(rows[-1][field]))

    def joy(self, rows: NDArray[np.void], name: str, halves: Mapping[str, float]) -> bytes:
        """Return the handle in the last of `rows`, as `/joy` has it.

        halves: half of the range of each axis, m and rad.
        """
        row = rows[-1]
        names = {place.rpartition("_")[0]: place for place in places_of(row.dtype.names or ())}
        places = {axis: _value(row, place) for axis, place in names.items()}
        places["x"] = -places["x"]
        axes = [places.get(axis, 0.0) / half for axis, half in halves.items()]
        buttons = [0] * DEAD_MAN_BUTTON + [int(bool(row["flags"] & DEAD_MAN))]
        return self._packed(
            JOY,
            header=self._header(name, int(row["time_ns"])),
            axes=np.array(axes, np.float32),
            buttons=np.array(buttons, np.int32),
        )

    def diagnostics(
        self, problems: Iterable[str], metrics: Mapping[str, Mapping[str, object]], session_ns: int
    ) -> bytes:
        """Return what is wrong, and figures by what they are about."""
        found = list(problems)
        status = [
            self._status("kontur_av: session", "; ".join(found) or "well", {}, wrong=bool(found)),
            *(self._status(f"kontur_av: {name}", "", values) for name, values in metrics.items()),
        ]
        return self._packed(DIAGNOSTICS, header=self._header("", session_ns), status=status)

    def read_joy(self, octets: bytes) -> JoyMessage:
        """Return a `sensor_msgs/Joy`; ProtocolError for octets of anything else."""
        joy = self._read(octets, JOY)
        return JoyMessage(tuple(joy.axes.tolist()), tuple(bool(button) for button in joy.buttons))

    def read_velocity(self, octets: bytes) -> Velocity:
        """Return a `geometry_msgs/TwistStamped`; ProtocolError for octets of anything else."""
        twist = self._read(octets, TWIST).twist
        linear, angular = twist.linear, twist.angular
        moved = {"x": linear.x, "y": linear.y, "z": linear.z}
        return moved | {"roll": angular.x, "pitch": angular.y, "yaw": angular.z}

    def _read(self, octets: bytes, name: str) -> Any:
        if len(octets) > MOST_OCTETS:
            raise ProtocolError(f"{len(octets)} octets are too long for {name}")
        try:
            return self._store.deserialize_cdr(octets, name)
        except Exception as error:
            # Whatever a library raises on an unknown sender's octets is the unknown sender's fault.
            raise ProtocolError(f"no {name}: {error}") from None

    def _packed(self, kind: str, **fields: Any) -> bytes:
        return bytes(self._store.serialize_cdr(self._made(kind, **fields), kind))

    def _made(self, kind: str, /, **fields: Any) -> Any:
        return self._store.types[kind](**fields)

    def _time(self, session_ns: int) -> Any:
        seconds, nanoseconds = divmod(max(0, session_ns + self._offset_ns), NS_PER_S)
        return self._made("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)

    def _header(self, name: str, session_ns: int) -> Any:
        return self._made("std_msgs/msg/Header", stamp=self._time(session_ns), frame_id=name)

    def _vector(self, values: Iterable[float]) -> Any:
        x, y, z = values
        return self._made("geometry_msgs/msg/Vector3", x=x, y=y, z=z)

    def _status(
        self, name: str, message: str, values: Mapping[str, object], *, wrong: bool = False
    ) -> Any:
        pair = "diagnostic_msgs/msg/KeyValue"
        return self._made(
            "diagnostic_msgs/msg/DiagnosticStatus",
            level=_ERROR if wrong else _WELL,
            name=name,
            message=message,
            hardware_id="",
            values=[self._made(pair, key=key, value=str(value)) for key, value in values.items()],
        )


def _value(row: np.void, field: str) -> float:
    """The value of a field; 0 of an axis that the session does not have."""
    return float(row[field]) if field in (row.dtype.names or ()) else 0.0
