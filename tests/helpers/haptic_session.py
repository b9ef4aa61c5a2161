"""A session of a haptic link with a peer that a test plays by itself."""

from typing import Any

from telepresence.haptics.loop import HapticLink
from telepresence.haptics.sample import Greeting
from telepresence.haptics.session import RobotSession

ROBOT_LIFE = 0x777


def begin_session(link: HapticLink[Any, Any], *, request: int = 0x500) -> int:
    """Exchange greetings with `link`; return the session number that its peer now sends with."""
    session = link.session
    if isinstance(session, RobotSession):
        boot_id = 0
        while True:
            session.handle_greeting(Greeting(0, request, boot_id))
            while (greeting := session.poll_greeting(0, 0)) is None:
                pass
            if greeting.session:
                return greeting.session
            boot_id = greeting.number
    asked = session.poll_greeting(0, 0)
    assert asked is not None
    session.handle_greeting(Greeting(session.sending + 1, ROBOT_LIFE << 8, asked.number))
    return session.sending
