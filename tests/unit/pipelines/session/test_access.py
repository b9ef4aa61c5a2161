"""Who may open what at a seat."""

import pytest

from pipelines.session.access import Access, AccessError, AccessKind, headers
from pipelines.session.seat_roles import Role

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
