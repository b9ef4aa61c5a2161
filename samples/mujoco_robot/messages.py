"""Where drivers, camera and physics meet, and what they tell each other. It needs no MuJoCo."""

import os
import socket
import struct
import tempfile
from pathlib import Path

from kontur_av import ConfigError
from telepresence import JointReading, RobotReading

#: Of a driver: what it does, the time since its last order (ms), and the force at the tip (N, N).
ORDER = struct.Struct("=BBdd")
#: A driver that was late for longer misses the rest; the physics has braked its arm by then.
MOST_MS = 20
BRAKE, FOLLOW, GOOD_BYE, SHOW = range(4)
JOINTS = 7
#: For a driver: tip (m), velocity (m/s), force of the surroundings (N); angles (rad) and torques
#: (N m) of the joints; contact; holds the ball.
STATE = struct.Struct(f"=6d{2 * JOINTS}d??")
#: The socket of the physics; each driver and camera has one beside it.
PHYSICS = "physics"


def reading_of(octets: bytes) -> RobotReading:
    """Return what a `STATE` says."""
    *values, contact, holds = STATE.unpack(octets)
    joints = tuple(map(JointReading, values[6 : 6 + JOINTS], values[6 + JOINTS :]))
    return RobotReading(*values[:6], contact=contact, holds=holds, joints=joints)


def session_directory() -> Path:
    """Where the processes of one session meet: those with the same parent. Others cannot enter.

    Raises ConfigError if it is not this user's own.
    """
    path = Path(tempfile.gettempdir()) / f"kontur-mujoco-{os.getuid()}-{os.getppid()}"
    path.mkdir(mode=0o700, exist_ok=True)
    status = path.lstat()
    if status.st_uid != os.getuid() or status.st_mode & 0o077:
        raise ConfigError(f"{path} is not this user's alone: remove it")
    return path


def own_socket(path: Path) -> socket.socket:
    """Open a socket that never blocks; what an earlier start has left is replaced."""
    path.unlink(missing_ok=True)
    udp = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    udp.setblocking(False)
    udp.bind(str(path))
    return udp
