"""A ROS 2 system of others in its own process: a zenoh router, and nodes of `zenoh-ros2-sdk`.

`Ros2Peer` starts it. What it heard is there after `end`: messages by topic, as plain values, and
the numbers in the attachments.
"""

import json
import os
import pickle
import subprocess
import sys
import threading
import time
from pathlib import Path

#: The fields of the messages, after the definitions of ROS 2.
DEFINITIONS = {
    "builtin_interfaces/msg/Time": "int32 sec\nuint32 nanosec\n",
    "std_msgs/msg/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    "geometry_msgs/msg/Point": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/msg/Vector3": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/msg/Quaternion": "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n",
    "geometry_msgs/msg/Pose": "Point position\nQuaternion orientation\n",
    "geometry_msgs/msg/Twist": "Vector3 linear\nVector3 angular\n",
    "geometry_msgs/msg/Wrench": "Vector3 force\nVector3 torque\n",
    "geometry_msgs/msg/PoseStamped": "std_msgs/Header header\nPose pose\n",
    "geometry_msgs/msg/TwistStamped": "std_msgs/Header header\nTwist twist\n",
    "geometry_msgs/msg/WrenchStamped": "std_msgs/Header header\nWrench wrench\n",
    "diagnostic_msgs/msg/KeyValue": "string key\nstring value\n",
    "diagnostic_msgs/msg/DiagnosticStatus": (
        "byte OK=0\nbyte WARN=1\nbyte ERROR=2\nbyte STALE=3\n"
        "byte level\nstring name\nstring message\nstring hardware_id\nKeyValue[] values\n"
    ),
    "diagnostic_msgs/msg/DiagnosticArray": "std_msgs/Header header\nDiagnosticStatus[] status\n",
    "sensor_msgs/msg/CompressedImage": "std_msgs/Header header\nstring format\nuint8[] data\n",
    "sensor_msgs/msg/Joy": "std_msgs/Header header\nfloat32[] axes\nint32[] buttons\n",
    "std_msgs/msg/String": "string data\n",
    "foxglove_msgs/msg/CompressedVideo": (
        "builtin_interfaces/Time timestamp\nstring frame_id\nuint8[] data\nstring format\n"
    ),
}
_PERIOD_S = 0.02


def needed(name):
    """The types within a type, those within them first."""
    package = name.split("/")[0]
    for line in DEFINITIONS[name].splitlines():
        kind = line.split()[0].removesuffix("[]")
        short = kind if "/" in kind else f"{package}/{kind}"
        full = short.replace("/", "/msg/")
        if full in DEFINITIONS:
            yield from needed(full)
            yield full


def hash_of(name):
    """The hash of a type, by the other side's own arithmetic."""
    from zenoh_ros2_sdk.utils import compute_type_hash_from_msg

    parts = {part: DEFINITIONS[part] for part in needed(name)}
    return compute_type_hash_from_msg(name, DEFINITIONS[name], parts)


class Ros2Peer:
    """topics: the types of those that it hears, by name."""

    def __init__(self, port, topics, directory, environment=None):
        self._file = Path(directory) / "peer.pickle"
        self.process = subprocess.Popen(
            [sys.executable, __file__, str(port), json.dumps(topics), str(self._file)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=environment or os.environ,
        )
        assert self.process.stdout.readline() == "ready\n"

    def say(self, *words):
        """Make it do something.

        joy X Y DEAD_MAN: publish that 50 times a second. twist X: so, too. quiet: publish no more.
        late TOPIC TYPE and latched TOPIC: hear it from now on.
        """
        self.process.stdin.write(" ".join(map(str, words)) + "\n")
        self.process.stdin.flush()

    def heard(self, topic):
        """How many messages of a topic came until now."""
        self.say("count", topic)
        return int(self.process.stdout.readline())

    def end(self):
        """Return what it heard."""
        self.process.stdin.close()
        assert self.process.wait(60) == 0
        return pickle.loads(self._file.read_bytes())


def plain(value):
    """A message as dictionaries, lists, octets and numbers."""
    if hasattr(value, "__dataclass_fields__"):
        return {name: plain(getattr(value, name)) for name in value.__dataclass_fields__}
    if hasattr(value, "tolist"):
        return value.tobytes() if value.dtype == "uint8" else value.tolist()
    return [plain(one) for one in value] if isinstance(value, list) else value


class _Talker(threading.Thread):
    """Publishes what it is told, again and again."""

    def __init__(self, publishers):
        super().__init__(daemon=True)
        self._joy, self._twist = publishers
        self.joy = self.twist = None

    def run(self):
        import numpy as np

        types = self._joy.session_mgr.store.types
        stamp = types["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
        header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="")
        vector, twist = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Twist"]
        while True:
            if (joy := self.joy) is not None:
                axes = np.array(joy[:2], np.float32)
                buttons = np.array([0, 0, 0, 0, int(joy[2])], np.int32)
                self._joy.publish(header=header, axes=axes, buttons=buttons)
            if (speed := self.twist) is not None:
                linear = vector(x=speed, y=0.0, z=0.0)
                moved = twist(linear=linear, angular=vector(x=0.0, y=0.0, z=0.0))
                self._twist.publish(header=header, twist=moved)
            time.sleep(_PERIOD_S)


def main(port, topics, file):
    import zenoh
    from zenoh.ext import HistoryConfig, declare_advanced_subscriber
    from zenoh_ros2_sdk import ROS2Publisher, ROS2Subscriber
    from zenoh_ros2_sdk.attachment import Attachment
    from zenoh_ros2_sdk.keyexpr import topic_keyexpr
    from zenoh_ros2_sdk.qos import QosProfile, QosReliability
    from zenoh_ros2_sdk.session import ZenohSession
    from zenoh_ros2_sdk.utils import ros2_to_dds_type

    config = zenoh.Config()
    config.insert_json5("mode", '"router"')
    config.insert_json5("listen/endpoints", json.dumps([f"tcp/127.0.0.1:{port}"]))
    config.insert_json5("scouting/multicast/enabled", "false")
    router = zenoh.open(config)
    own = ZenohSession.get_instance("127.0.0.1", int(port))
    messages, numbers, tokens = {}, {}, []
    place = {"router_ip": "127.0.0.1", "router_port": int(port)}
    watched = own.liveliness.declare_subscriber(
        "@ros2_lv/**", lambda sample: tokens.append(str(sample.key_expr)), history=True
    )

    def registered(kind):
        for one in (*needed(kind), kind):
            own.register_message_type(DEFINITIONS[one], one)
        return {"msg_definition": DEFINITIONS[kind], "type_hash": hash_of(kind), **place}

    def hear(topic, kind):
        came, told = messages.setdefault(topic, []), numbers.setdefault(topic, [])
        quality = QosProfile(reliability=QosReliability.BEST_EFFORT)
        more = registered(kind)
        sub = ROS2Subscriber(topic, kind, lambda one: came.append(plain(one)), qos=quality, **more)

        def note(sample):
            found = Attachment.from_bytes(sample.attachment.to_bytes())
            told.append((found.sequence_id, found.timestamp_ns, found.gid))

        return sub, own.session.declare_subscriber(sub.keyexpr, note)

    def hear_latched(topic, kind):
        """As rmw_zenoh does: ROS2Subscriber looks for no latched topic with a second slash."""
        more = registered(kind)
        came = messages.setdefault(topic, [])
        key = topic_keyexpr(0, topic, ros2_to_dds_type(kind), more["type_hash"])

        def note(sample):
            came.append(plain(own.store.deserialize_cdr(sample.payload.to_bytes(), kind)))

        history = HistoryConfig(detect_late_publishers=True)
        return declare_advanced_subscriber(own.session, key, note, history=history)

    subs = [hear(topic, kind) for topic, kind in json.loads(topics).items()]
    joy, twist = "sensor_msgs/msg/Joy", "geometry_msgs/msg/TwistStamped"
    talker = _Talker(
        (
            ROS2Publisher("/joy", joy, **registered(joy)),
            ROS2Publisher("/cmd_vel", twist, **registered(twist)),
        )
    )
    talker.start()
    print("ready", flush=True)
    for line in sys.stdin:
        what, *values = line.split()
        if what == "count":
            print(len(messages[values[0]]), flush=True)
        elif what == "late":
            subs.append(hear(*values))
        elif what == "latched":
            subs.append(hear_latched(values[0], "std_msgs/msg/String"))
        elif what == "joy":
            talker.joy = (float(values[0]), float(values[1]), values[2] == "True")
        elif what == "twist":
            talker.twist = float(values[0])
        else:
            talker.joy = talker.twist = None
    found = {"messages": messages, "numbers": numbers, "tokens": tokens}
    Path(file).write_bytes(pickle.dumps(found))
    watched.undeclare()
    own.close()
    router.close()
    # The other side's threads need no farewell.
    os._exit(0)


if __name__ == "__main__":
    main(*sys.argv[1:])
