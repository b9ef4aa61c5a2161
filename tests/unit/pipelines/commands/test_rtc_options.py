"""What options say of a TURN server and of those who get the token."""

import pytest

from kontur_av.errors import ConfigError
from pipelines.cli import make_parser
from pipelines.commands.rtc_options import ice_servers_of
from pipelines.session.options import stream_options

URL = "http://127.0.0.1/whep"


@pytest.fixture
def watch(tmp_path):
    password = tmp_path / "password"
    password.write_text("of-the-turn-server\n")
    password.chmod(0o600)

    def parsed(*words):
        words = [str(password) if word == "PASSWORD" else word for word in words]
        return make_parser("watch").parse_args(["watch", "--whep", URL, *words])

    return parsed


def test_a_lasting_user_of_a_turn_server_has_a_name_and_a_password(watch):
    words = ("--ice-server", "turn:turn.example", "--turn-user", "iss")
    args = watch(*words, "--turn-password-file", "PASSWORD")
    (server,) = ice_servers_of(stream_options(args))().servers
    assert (server.username, server.credential) == ("iss", "of-the-turn-server")
    for refused, told in (
        (words, "or neither"),
        ((*words[:2], "--turn-password-file", "PASSWORD"), "or neither"),
        (
            (*words, "--turn-password-file", "PASSWORD", "--turn-secret-file", "PASSWORD"),
            "give one",
        ),
        (words[2:], "--turn-user belongs to a server"),
    ):
        with pytest.raises(ConfigError, match=told):
            ice_servers_of(stream_options(watch(*refused)))
    args = watch("--token-origin", "https://a.example", "--token-origin", "https://b.example")
    assert [*args.token_origin] == ["https://a.example", "https://b.example"]
    assert not [*watch().token_origin]
