"""Join a running session: the operator's pictures, the robot's samples, a telecommand, a camera.

kontur-av stream --setup spacejustin &
python samples/join_session.py [SESSION [CAMERA]]     without a name: the only one that runs

With a CAMERA it selects that one: the operator's picture changes, and the robot holds.
"""

import sys

from pipelines import JoinedSession

with JoinedSession(sys.argv[1] if len(sys.argv) > 1 else None) as session:
    print(session.command("joystick", "ping"))
    if len(sys.argv) > 2:
        print(session.select(sys.argv[2]))
    for _, picture in zip(range(30), session.pictures(), strict=False):
        print(f"{picture.data.shape}, {picture.age_ms:.0f} ms old, {picture.quality.name}")
    for _, rows in zip(range(3), session.samples("robot"), strict=False):
        print(rows[["time_ns", "x_m", "fx_n"]][0])
