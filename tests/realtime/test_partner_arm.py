"""A partner drives the robot in place of the ISS, or an arm of its own: real sockets and loops."""

import contextlib
import os
import re
import signal
import socket
from urllib.error import HTTPError
from urllib.request import Request, urlopen

import pytest
from programs import running
from running_session import COMMAND, SEAT, TIMEOUT_S, eventually, restarted, tcp_port

_SHORT = SEAT + 'partner_arm = "ARM"\n'


def authority(session, *words):
    return session.ask("authority", *words)


def hand_over(session, to):
    done = authority(session, to)
    assert done.returncode == 0, done
    assert f"{to} drives" in done.stdout


class Partner(contextlib.ExitStack):
    """`kontur-av joystick drive`, beside a session without options. Its exit ends it."""

    def __init__(self, session, path, *options):
        super().__init__()
        self._path = path
        options = options or ("--base-port", str(session.base_port))
        how = {"end": signal.SIGKILL, "env": session.environment}
        command = (*COMMAND, "joystick", "drive", *options)
        self.process = self.enter_context(running(path, *command, **how))

    def wait_for(self, words):
        eventually(lambda: self._path.read_text().rstrip().endswith(words), words)

    def end(self):
        """Press Ctrl-C; return the exit code and the samples that it got."""
        self.process.send_signal(signal.SIGINT)
        code = self.process.wait(TIMEOUT_S)
        return code, int(re.search(r"(\d+) from it", self._path.read_text())[1])


def test_the_port_goes_to_the_partner_and_back_and_outlives_desk_and_robot(start, tmp_path):
    session = start(_SHORT.replace("ARM", "shared"))
    pids = session.pids()
    session.wait_for_flow()
    eventually(
        lambda: authority(session).stdout == "operator drives\n", "the joystick in space drives"
    )
    with Partner(session, tmp_path / "partner.txt") as partner:
        hand_over(session, "partner")
        partner.wait_for("answers")
        # The desk and the robot come back with the owner that was ordered.
        for name in ("owner_desk", "robot"):
            session.kill(pids, name)
        eventually(
            lambda: authority(session).stdout.startswith("partner drives"), "the partner again"
        )
        assert authority(session, "bob").returncode == 2
        hand_over(session, "operator")
        partner.wait_for("silent")
        code, got = partner.end()
    assert code == 0 and got > 0
    session.wait_for_flow()
    _, report = session.interrupt()
    arm = report["arm"]
    assert arm["authority"] == arm["wanted"] == "operator"
    assert arm["refused"]["partner"] > 0 and arm["refused"]["operator"] > 0
    assert set(restarted(report)) == {"owner_desk", "robot"}


def across(tmp_path):
    """Return options of a session, and the words by which a partner's joystick reaches it."""
    seen, hand, port = tmp_path / "seen", tmp_path / "hand", tcp_port()
    seen.write_text("word-of-the-partner")
    hand.write_text("word-of-the-hand")
    options = ("--rtc", str(port), "--rtc-token-file", seen, "--rtc-hand-token-file", hand)
    url = f"http://127.0.0.1:{port}"
    return [*map(str, options)], url, ("--rtc", url, "--token-file", str(hand))


def test_one_joystick_drives_across_the_internet_until_the_owner_takes_the_robot(start, tmp_path):
    options, _, words = across(tmp_path)
    session = start(_SHORT.replace("ARM", "shared"), *options)
    session.wait_for_flow()
    hand_over(session, "partner")
    viewer = (*words[:2], "--token-file", str(tmp_path / "seen"))
    with Partner(session, tmp_path / "viewer.txt", *viewer) as watching:
        watching.wait_for(
            "this token may not (403): this token may only watch and send: take the other one"
        )
    with Partner(session, tmp_path / "first.txt", *words) as first:
        first.wait_for("answers")
        with Partner(session, tmp_path / "second.txt", *words) as second:
            second.wait_for("the owner takes the robot back")
            assert "taken its place" not in (tmp_path / "first.txt").read_text()
            hand_over(session, "operator")
            eventually(
                lambda: "another one has taken its place" in (tmp_path / "first.txt").read_text(),
                "the second joystick in the place of the first",
            )
            hand_over(session, "partner")
            second.wait_for("answers")
    # Both were killed; nothing of them keeps another one out.
    with Partner(session, tmp_path / "third.txt", *words) as third:
        third.wait_for("answers")
    session.interrupt()


def test_a_second_arm_is_the_partners_own_across_the_internet(start, tmp_path):
    options, url, words = across(tmp_path)
    session = start(_SHORT.replace("ARM", "second"), *options)
    pids = session.pids()
    session.wait_for_flow()
    with Partner(
        session, tmp_path / "unknown sender.txt", "--rtc", url, "--token", "guess"
    ) as unknown:
        unknown.wait_for("the token is not taken (401): this address needs the token")
    headers = {"Authorization": f"Bearer {(tmp_path / 'hand').read_text()}"}
    request = Request(f"{url}/haptics", b"v=0", headers)
    request.add_header("Content-Type", "application/sdp")
    with pytest.raises(HTTPError, match="400"):
        urlopen(request)
    with Partner(session, tmp_path / "partner.txt", *words) as partner:
        partner.wait_for("answers")
        said, before = tmp_path / "partner.txt", len((tmp_path / "partner.txt").read_text())
        os.kill(pids["rtc"], signal.SIGKILL)
        back = re.compile(r"silent\n.*answers\n\Z", re.DOTALL)
        eventually(lambda: back.search(said.read_text()[before:]), "silence and answers")
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as unknown:
            for size in range(32):
                unknown.sendto(bytes(size), ("127.0.0.1", session.base_port + 7))
        assert authority(session).returncode == 2
        session.wait_for_flow()
        assert partner.end()[1] > 0
    report = session.finish()
    second = report["second_arm"]
    assert second["received"] > 0 and second["sessions"] >= 1
    samples = report["rtc"]["samples"]
    # What a killed process counted since its last report, half a second at most, is lost.
    assert samples["taken"] >= second["received"] - 700 and samples["given"] > 0
    # Nobody reaches an arm by UDP.
    assert second["garbage"] == 0
    assert report["haptic"]["up"]["received"] > 0
