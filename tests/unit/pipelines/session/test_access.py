"""Who may open what at a seat, who may ask for what, and how many connections a server keeps."""

import pytest

from pipelines.session.access import (
    MOST_CONNECTIONS,
    MOST_OF_ADDRESS,
    MOST_STRANGERS,
    PEOPLE,
    STRANGER_NS,
    Access,
    AccessError,
    AccessKind,
    Doorway,
    Role,
    chat_role,
    headers,
    refusal,
)
from pipelines.session.setup.segments import Segment
from telepresence.tmtc.k2aci import ChatRole

OPERATOR, VIEWER = "operator-token", "viewer-token"
HOST = "127.0.0.1:8270"


def access(**changes):
    given = {"seat": "space", "scheme": "http", "port": 8270, "names": ("127.0.0.1", "localhost")}
    return Access(**given | changes, operator_token=OPERATOR, viewer_token=VIEWER)


def found(target, *, host=HOST, origin=None, method="GET", **changes):
    return access(**changes).find(method, target, host, origin)


def refused(*args, **changes):
    with pytest.raises(AccessError) as error:
        found(*args, **changes)
    return error.value.status, error.value.reason


def test_the_token_says_what_its_owner_may():
    assert found(f"/space?token={OPERATOR}")[:2] == (AccessKind.PAGE, Role.OPERATOR)
    assert found(f"/space?x=1&token={VIEWER}")[:2] == (AccessKind.PAGE, Role.VIEWER)
    assert found(f"/{VIEWER}/static/space.js")[:2] == (AccessKind.FILE, Role.VIEWER)
    for path, kind in (("ws", AccessKind.SEAT), ("media", AccessKind.MEDIA)):
        assert found(f"/{OPERATOR}/{path}", origin=f"http://{HOST}")[:2] == (kind, Role.OPERATOR)


@pytest.mark.parametrize(
    "target",
    [
        "/",
        "",
        "/space",
        "/space?token=",
        "/space?token=Operator-token",
        "/ground?token=operator-token",
        "/operator-toke/static/space.js",
        "//static/space.js",
        "/\udce9/ws",
        "*",
    ],
)
def test_without_the_token_nothing_is_served(target):
    assert refused(target, origin=f"http://{HOST}") == (403, "token")


@pytest.mark.parametrize(
    "name",
    ["..%2fserver.py", "../server.py", ".hidden", "server", "A.js", "a/b.js", "a.js%00", ""],
)
def test_only_plain_names_are_files(name):
    assert refused(f"/{OPERATOR}/static/{name}")[0] == 404


@pytest.mark.parametrize(
    "host",
    [
        "evil.example:8270",
        "127.0.0.1",
        "127.0.0.1:8271",
        "127.0.0.1:8270.evil.example",
        "127.0.0.2:8270",
        "user@127.0.0.1:8270",
        "",
        "[::1:8270",
    ],
)
def test_another_name_of_this_machine_is_refused(host):
    """An attacker's name that resolves to 127.0.0.1 (DNS rebinding)."""
    assert refused(f"/space?token={OPERATOR}", host=host) == (403, "host")


def test_beyond_loopback_any_address_is_good_but_no_other_name():
    far = {"scheme": "https", "names": ("10.0.0.7", "console")}
    for host in ("10.0.0.7:8270", "192.168.1.5:8270", "[fe80::1]:8270", "CONSOLE:8270"):
        assert found(f"/space?token={OPERATOR}", host=host, **far)
    assert refused(f"/space?token={OPERATOR}", host="evil.example:8270", **far) == (403, "host")


def test_a_browser_leaves_the_usual_port_out():
    assert found(f"/space?token={OPERATOR}", host="127.0.0.1", port=80)


@pytest.mark.parametrize(
    "origin",
    [None, "null", "http://evil.example", "https://127.0.0.1:8270", "http://127.0.0.1:8271"],
)
def test_only_the_page_itself_may_open_a_socket(origin):
    for path in ("ws", "media"):
        assert refused(f"/{OPERATOR}/{path}", origin=origin) == (403, "origin")


def test_only_get():
    assert refused(f"/space?token={OPERATOR}", method="POST")[0] == 405


def test_every_answer_forbids_all_but_its_own_origin():
    policy = headers(HOST)["Content-Security-Policy"]
    assert "default-src 'none'" in policy and "frame-ancestors 'none'" in policy
    assert f"connect-src 'self' ws://{HOST} wss://{HOST}" in policy
    assert "unsafe" not in policy


@pytest.mark.parametrize(
    ("role", "deed"),
    [
        (Role.COSMONAUT, "panel.button"),
        (Role.COSMONAUT, "hand"),
        (Role.EXPERIMENTER, "tasks.select"),
        (Role.EXPERIMENTER, "robot.reset_error"),
        (Role.EXPERIMENTER, "robot.set_mode"),
        (Role.SUPERVISOR, "joystick.halt"),
        (Role.SUPERVISOR, "session"),
        (Role.SYSTEMS, "housekeeping"),
        (Role.SYSTEMS, "fetch"),
    ],
)
def test_each_of_the_people_does_what_is_theirs(role, deed):
    segment = next(one for one, people in PEOPLE.items() if role in people)
    assert refusal(role, segment, deed) == ""
    assert refusal(Role.OPERATOR, segment, deed) == ""
    assert refusal(Role.VIEWER, segment, deed) == "a viewer may watch only"


def test_a_refusal_names_who_may():
    words = refusal(Role.SUPERVISOR, Segment.GROUND, "tasks.select")
    assert words == "tasks select: the experimenter may, not the supervisor"
    words = refusal(Role.OPERATOR, Segment.SPACE, "robot.power_off")
    assert words == "robot power off: the experimenter or the supervisor may, not people in space"
    words = refusal(Role.SYSTEMS, Segment.GROUND, "robot.melt")
    assert words == "robot melt: nobody may, not the systems operator"


def test_everybody_but_viewers_writes_in_the_chat_as_who_they_are():
    named = {
        chat_role(role, segment)
        for segment, people in PEOPLE.items()
        for role in people
        if refusal(role, segment, "chat") == ""
    }
    assert named == set(ChatRole)
    assert chat_role(Role.OPERATOR, Segment.SPACE) is ChatRole.COSMONAUT


def test_idle_strangers_make_room_and_known_connections_stay():
    door = Doorway()
    door.handle_accepted(0, "operator", 0)
    door.handle_known(0)
    closed = []
    for number in range(1, 1401):
        closed += door.handle_accepted(number, f"host {number % 50}", number)
    assert len(closed) == door.closed == 1400 - MOST_STRANGERS
    assert 0 not in closed
    # The newest stay long enough to show their token.
    assert closed == list(range(1, 1401 - MOST_STRANGERS))
    for number in range(1401, 1401 + 100):
        door.handle_accepted(number, "lan", 2000)
        door.handle_known(number)
    assert len(door) == 101 + MOST_STRANGERS - 1


def test_one_address_has_fewer():
    door = Doorway()
    door.handle_accepted(0, "other", 0)
    closed = [one for n in range(1, 100) for one in door.handle_accepted(n, "same", 0)]
    assert closed == list(range(1, 100 - MOST_OF_ADDRESS))


def test_strangers_have_little_time_and_the_known_have_all():
    door = Doorway()
    for number in range(3):
        door.handle_accepted(number, "a", 0)
    door.handle_known(1)
    assert door.handle_time(STRANGER_NS - 1) == []
    assert door.handle_time(STRANGER_NS) == [0, 2]
    assert door.handle_time(10 * STRANGER_NS) == []
    door.handle_closed(1)
    door.handle_closed(1)
    assert len(door) == 0


def test_beyond_all_connections_a_new_stranger_is_closed():
    door = Doorway()
    for number in range(MOST_CONNECTIONS):
        door.handle_accepted(number, f"{number}", 0)
        door.handle_known(number)
    assert door.handle_accepted(1000, "late", 0) == [1000]
