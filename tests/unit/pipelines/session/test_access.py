"""Who may open what at a seat, who may ask for what, and how many connections a server keeps."""

import pytest

from pipelines.session import access
from pipelines.session.setup.segments import Segment
from telepresence.tmtc.k2aci import ChatRole
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary

OPERATOR, VIEWER = "operator-token", "viewer-token"
HOST = "127.0.0.1:8270"
PAGE = f"/space?token={OPERATOR}"
SOCKET = f"/{OPERATOR}/ws"
FAR = {"scheme": "https", "names": ("10.0.0.7", "console")}


def found(target=PAGE, *, host=HOST, origin=f"http://{HOST}", method="GET", **changes):
    known = {"seat": "space", "scheme": "http", "port": 8270, "names": ("127.0.0.1", "localhost")}
    gate = access.Access(**known | changes, operator_token=OPERATOR, viewer_token=VIEWER)
    return gate.find(method, target, host, origin)[:2]


def test_the_token_says_what_its_owner_may():
    assert found() == (access.AccessKind.PAGE, access.Role.OPERATOR)
    viewer, kind = access.Role.VIEWER, access.AccessKind
    assert found(f"/space?x=1&token={VIEWER}", origin=None) == (kind.PAGE, viewer)
    assert found(f"/{VIEWER}/static/space.js", origin=None) == (kind.FILE, viewer)
    assert found(SOCKET) == (access.AccessKind.SEAT, access.Role.OPERATOR)
    assert found(f"/{OPERATOR}/media") == (access.AccessKind.MEDIA, access.Role.OPERATOR)
    # A browser leaves the usual port out. Beyond loopback any address is good.
    assert found(host="127.0.0.1", port=80)
    for host in ("10.0.0.7:8270", "192.168.1.5:8270", "[fe80::1]:8270", "CONSOLE:8270"):
        assert found(host=host, **FAR)


REFUSED = {
    (403, "token"): [
        {"target": target}
        for target in (
            *("/", "", "/space", "/space?token=", "/space?token=Operator-token", "*"),
            *("/ground?token=operator-token", "/operator-toke/static/space.js"),
            *("//static/space.js", "/\udce9/ws"),
        )
    ],
    # An attacker's name that resolves to 127.0.0.1 (DNS rebinding).
    (403, "host"): [
        *({"host": f"{name}:8270"} for name in ("evil.example", "127.0.0.2", "user@127.0.0.1")),
        *({"host": host} for host in ("127.0.0.1", "127.0.0.1:8271", "", "[::1:8270")),
        {"host": "127.0.0.1:8270.evil.example"},
        {"host": "evil.example:8270", **FAR},
    ],
    # Only the page itself may open a socket.
    (403, "origin"): [
        {"target": target, "origin": origin}
        for target in (SOCKET, f"/{OPERATOR}/media")
        for origin in (
            *(None, "null", "http://evil.example"),
            *("https://127.0.0.1:8270", "http://127.0.0.1:8271"),
        )
    ],
    # Only plain names are files.
    (404, None): [
        {"target": f"/{OPERATOR}/static/{name}"}
        for name in (
            *("..%2fserver.py", "../server.py", ".hidden", "server", "A.js", "a/b.js"),
            *("a.js%00", ""),
        )
    ],
    (405, None): [{"method": "POST"}],
}


@pytest.mark.rule("10")
@pytest.mark.parametrize(
    ("status", "reason", "request_"),
    [(*refused, each) for refused, requests in REFUSED.items() for each in requests],
)
def test_what_is_asked_for_otherwise_is_refused(status, reason, request_):
    with pytest.raises(access.AccessError) as error:
        found(**request_)
    assert error.value.status == status
    assert reason in (None, error.value.reason)


@pytest.mark.parametrize("deed", [one for one in access._MAY if "." in one])
def test_each_telecommand_that_a_role_may_give_exists(deed):
    application, _, function = deed.partition(".")
    known = built_in_dictionary().application(application).functions
    assert function in {one.name for one in known}


def test_a_refusal_names_who_may_and_everybody_but_viewers_writes_in_the_chat():
    words = access.refusal(access.Role.SUPERVISOR, Segment.GROUND, "tasks.select")
    assert words == "tasks select: the experimenter may, not the supervisor"
    words = access.refusal(access.Role.OPERATOR, Segment.SPACE, "robot.power_off")
    assert words == "robot power off: the experimenter or the supervisor may, not people in space"
    words = access.refusal(access.Role.SYSTEMS, Segment.GROUND, "robot.melt")
    assert words == "robot melt: nobody may, not the systems operator"
    named = {
        access.chat_role(role, segment)
        for segment, people in access.PEOPLE.items()
        for role in people
        if access.refusal(role, segment, "chat") == ""
    }
    assert named == set(ChatRole)
    assert access.chat_role(access.Role.OPERATOR, Segment.SPACE) is ChatRole.COSMONAUT
    policy = access.headers(HOST)["Content-Security-Policy"]
    assert "default-src 'none'" in policy and "frame-ancestors 'none'" in policy
    assert f"connect-src 'self' ws://{HOST} wss://{HOST}" in policy
    assert "unsafe" not in policy

    theirs = {
        access.Role.COSMONAUT: ("panel.button", "hand"),
        access.Role.EXPERIMENTER: ("tasks.select", "robot.reset_error", "robot.set_mode"),
        access.Role.SUPERVISOR: ("joystick.halt", "session"),
        access.Role.SYSTEMS: ("housekeeping", "fetch"),
    }
    for role, deeds in theirs.items():
        segment = next(one for one, people in access.PEOPLE.items() if role in people)
        for deed in deeds:
            assert access.refusal(role, segment, deed) == ""
            assert access.refusal(access.Role.OPERATOR, segment, deed) == ""
            assert access.refusal(access.Role.VIEWER, segment, deed) == "a viewer may watch only"


def test_idle_strangers_make_room_and_known_connections_stay():
    admission = access.ConnectionLimits()
    admission.handle_accepted(0, "operator", 0)
    admission.handle_known(0)
    closed = []
    for number in range(1, 1401):
        closed += admission.handle_accepted(number, f"host {number % 50}", number)
    # The newest stay long enough to show their token.
    assert closed == list(range(1, 1401 - access.MOST_UNAUTHENTICATED))
    assert admission.closed == len(closed)
    for number in range(1401, 1401 + 100):
        admission.handle_accepted(number, "lan", 2000)
        admission.handle_known(number)
    assert len(admission) == 101 + access.MOST_UNAUTHENTICATED - 1
    # Who only watches makes room for those who came later.
    closed = []
    for number in range(2000, 2000 + 1100):
        admission.handle_accepted(number, "viewer", 3000)
        closed += admission.handle_known(number, watches=True)
    assert closed == list(range(2000, 3100 - access.MOST_WATCHING))
    assert 4000 not in admission.handle_accepted(4000, "operator", 4000)
    # One address has fewer.
    admission = access.ConnectionLimits()
    admission.handle_accepted(0, "other", 0)
    closed = [one for n in range(1, 100) for one in admission.handle_accepted(n, "same", 0)]
    assert closed == list(range(1, 100 - access.MOST_OF_ADDRESS))


def test_strangers_have_little_time_and_the_known_have_all_but_room():
    admission = access.ConnectionLimits()
    for number in range(3):
        admission.handle_accepted(number, "a", 0)
    admission.handle_known(1)
    assert admission.handle_time(access.UNAUTHENTICATED_NS - 1) == []
    assert admission.handle_time(access.UNAUTHENTICATED_NS) == [0, 2]
    assert admission.handle_time(10 * access.UNAUTHENTICATED_NS) == []
    admission.handle_closed(1)
    admission.handle_closed(1)
    assert len(admission) == 0
    for number in range(access.MOST_CONNECTIONS):
        admission.handle_accepted(number, f"{number}", 0)
        admission.handle_known(number)
    assert admission.handle_accepted(1000, "late", 0) == [1000]
