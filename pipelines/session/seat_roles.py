"""The people of a session (Stelzer et al. 2017, section 8), and what each of them may ask for."""

from collections.abc import Mapping
from enum import Enum

from pipelines.session.setup.segments import Segment
from telepresence.tmtc.k2aci import ChatRole


class Role(Enum):
    """What a page may do, by its token. The operator may do what all people of its end may."""

    OPERATOR = "operator"
    COSMONAUT = "cosmonaut"
    EXPERIMENTER = "experimenter"
    SUPERVISOR = "supervisor"
    SYSTEMS = "systems"
    TRAINER = "trainer"
    VIEWER = "viewer"

    @property
    def words(self) -> str:
        return "systems operator" if self is Role.SYSTEMS else self.value


#: By end: its people, besides the session's owner, its trainer and those who watch.
PEOPLE: Mapping[Segment, tuple[Role, ...]] = {
    Segment.SPACE: (Role.COSMONAUT,),
    Segment.GROUND: (Role.EXPERIMENTER, Role.SUPERVISOR, Role.SYSTEMS),
}

VIEWER_WORDS = "a viewer may watch only"

_JOYSTICK = (
    *("calibrate", "start", "start_russian", "stop", "halt", "resume", "acknowledge", "test"),
)
#: Who may do what. Telecommands are named APPLICATION.FUNCTION, those of reports `housekeeping`.
_MAY: Mapping[str, tuple[Role, ...]] = {
    "hand": (Role.COSMONAUT,),
    "joystick": (Role.COSMONAUT,),
    "session": (Role.COSMONAUT, Role.SUPERVISOR),
    "record": PEOPLE[Segment.GROUND],
    "chat": (*PEOPLE[Segment.SPACE], *PEOPLE[Segment.GROUND]),
    "housekeeping": (Role.SUPERVISOR, Role.SYSTEMS),
    **{f"joystick.{name}": (Role.COSMONAUT, Role.SUPERVISOR) for name in _JOYSTICK},
    "camera.select": (Role.COSMONAUT,),
    "panel.button": (Role.COSMONAUT,),
    "tasks.select": (Role.EXPERIMENTER,),
    "tasks.start": (Role.EXPERIMENTER,),
    "tasks.abort": (Role.EXPERIMENTER, Role.SUPERVISOR),
    **{
        f"{end}_supervisor.{name}": (Role.SUPERVISOR, Role.SYSTEMS)
        for end in ("space", "ground")
        for name in ("start", "stop")
    },
    "robot.power_on": (Role.EXPERIMENTER,),
    "robot.power_off": (Role.EXPERIMENTER, Role.SUPERVISOR),
    "robot.set_mode": (Role.EXPERIMENTER,),
    "robot.reset_error": (Role.EXPERIMENTER,),
    "robot.emergency_stop": (*PEOPLE[Segment.SPACE], *PEOPLE[Segment.GROUND]),
    "robot.release_stop": (Role.COSMONAUT, Role.SUPERVISOR),
    "fetch": (Role.SUPERVISOR, Role.SYSTEMS),
    "exercise": (Role.TRAINER,),
}


def refusal(role: Role, segment: Segment, deed: str) -> str:
    """Return why `role` at a page of `segment` may not do this; "" if it may.

    deed: what a page asks for, or of a telecommand `housekeeping` or APPLICATION.FUNCTION.
    """
    if role is Role.VIEWER:
        return VIEWER_WORDS
    may = _MAY.get(deed, ())
    given = PEOPLE[segment] if role is Role.OPERATOR else (role,)
    if any(one in may for one in given):
        return ""
    asked = deed.replace(".", " ").replace("_", " ")
    who = " or ".join(f"the {one.words}" for one in may) or "nobody"
    you = f"people in {segment.value}" if role is Role.OPERATOR else f"the {role.words}"
    if role is Role.OPERATOR and segment is Segment.GROUND:
        you = "people on the ground"
    return f"{asked}: {who} may, not {you}"


def place_name(role: Role, segment: Segment) -> str:
    """Return who sits at a page, as the others of its end read it."""
    ground = segment is Segment.GROUND
    return "ground control" if role is Role.OPERATOR and ground else role.words


def chat_role(role: Role, segment: Segment) -> ChatRole:
    """As whom a page writes in the chat."""
    if role is Role.OPERATOR:
        return ChatRole.COSMONAUT if segment is Segment.SPACE else ChatRole.OPERATOR
    return ChatRole.OPERATOR if role is Role.SYSTEMS else ChatRole(role.value)
