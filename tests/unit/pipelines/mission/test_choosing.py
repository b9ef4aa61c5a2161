"""A selection is completed when no picture of another camera is coded or sent any more."""

import pytest

from kontur_av.errors import ConfigError
from kontur_av.media import CaptureStamp
from pipelines.media.following import AGAIN_NS, CameraFollower, Choice
from pipelines.mission.choosing import CameraChoice
from pipelines.mission.supervisor import session_dictionary
from pipelines.mission.tmtc_messages import FunctionAsked, FunctionDone, RaiseEvent, SetValues
from pipelines.session.probe import Probe
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.session.setup.table import MAX_CAMERA_OCTETS
from pipelines.session.topology.table import Topology
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary

CAMERAS = BUILT_IN["spacejustin"].cameras
SUPERSEDED = "a later request came"


class Selection:
    """A choice of cameras and the sender that follows it."""

    def __init__(self, kept="", now_ns=0, follower=None):
        self.choice = CameraChoice(CAMERAS, Probe(), now_ns=now_ns, kept=kept)
        self.follower = follower or CameraFollower()

    def publish(self, now_ns):
        """The sender hears the choice; True if it is to follow another camera."""
        return self.follower.handle_choice(self.choice.poll_choice(now_ns))

    def confirm(self, now_ns):
        self.choice.handle_confirmed(self.follower.poll_confirmed(now_ns))

    def ask(self, text, token, now_ns, function="select"):
        asked = FunctionAsked("camera", token, function, (text,), "space")
        return self.choice.handle_asked(asked, now_ns)

    def answers(self):
        """By token: why it was refused, or ""."""
        requests = iter(self.choice.next_event, None)
        return {one.token: one.refusal for one in requests if isinstance(one, FunctionDone)}


@pytest.fixture
def one():
    return Selection()


def test_the_completion_waits_until_the_sender_has_left_the_camera(one):
    choice, follower = one.choice, one.follower
    assert one.publish(0)
    one.confirm(1)
    assert choice.next_event() == SetValues("camera", {"camera": "stereo"})
    assert one.ask("static", 1, 10)
    assert choice.next_event() is None
    assert one.publish(10)
    assert follower.camera == "static"
    assert follower.leaving and follower.poll_confirmed(11) is None
    assert not follower.handle_sender(idle=False)
    # Another telecommand for the same camera is not completed earlier.
    assert not one.ask("static", 2, 20)
    assert choice.next_event() is None
    assert follower.handle_sender(idle=True)
    one.confirm(30)
    assert choice.next_event() == SetValues("camera", {"camera": "static"})
    assert one.answers() == {1: "", 2: ""}
    # The camera is already selected.
    assert not one.ask("static", 3, 40)
    assert one.answers() == {3: ""}
    assert not one.ask("nowhere", 4, 50)
    assert one.answers() == {4: f"unknown camera nowhere: choose one of {', '.join(CAMERAS)}"}


def test_a_later_request_ends_an_earlier_one(one):
    choice, follower = one.choice, one.follower
    one.publish(0)
    first = follower.poll_confirmed(0)
    one.ask("static", 1, 10)
    one.ask("head", 2, 11)
    assert one.answers() == {1: SUPERSEDED}
    # An old confirmation completes nothing new.
    choice.handle_confirmed(first)
    assert one.answers() == {}
    one.publish(12)
    follower.handle_sender(idle=True)
    one.confirm(13)
    assert one.answers() == {2: ""}
    # A task on the ground does so, too.
    one.ask("static", 3, 20)
    assert choice.select("stereo", 21)
    assert one.answers() == {3: SUPERSEDED}
    assert not choice.select("stereo", 22)
    assert not choice.select("nowhere", 23)


def test_a_restarted_selector_waits_for_its_own_number(one):
    one.publish(0)
    old = one.follower.poll_confirmed(0)
    # It was killed after it kept the choice and before it published it.
    after = Selection("static", 1000, one.follower)
    after.choice.handle_confirmed(old)
    after.ask("static", 5, 1002)
    assert after.answers() == {}
    after.publish(1002)
    assert after.follower.leaving
    after.follower.handle_sender(idle=True)
    after.confirm(1003)
    assert after.answers() == {5: ""}


def test_a_focus_is_told_confirmed_and_kept_and_another_camera_takes_it_away(one):
    assert one.publish(0) and one.ask("0.4,0.3,0.2,0.25", 1, 10, "focus")
    assert not one.publish(10) and not one.answers()
    one.confirm(11)
    _, told, *said = iter(one.choice.next_event, None)
    assert told == SetValues("camera", {"focus": "0.4,0.3,0.2,0.25"})
    assert said == [RaiseEvent("camera", "focus_changed"), FunctionDone("camera", 1)]
    assert str(Selection(one.choice.kept).choice.poll_choice(20).focus) == "0.4,0.3,0.2,0.25"
    for wrong in ("0.4,0.3,0.2", "nan,0,1,1", "0,0,0,1", "here"):
        assert not one.ask(wrong, 2, 30, "focus") and "like 0.4,0.3," in one.answers()[2]
    assert one.ask("static", 3, 40) and one.choice.kept == "static off"


def test_a_restarted_sender_confirms_the_first_choice_that_it_receives(one):
    one.ask("static", 1, 10)
    assert one.follower.poll_confirmed(10) is None
    assert one.publish(15)
    one.confirm(20)
    assert one.answers() == {1: ""}
    # Functions of other applications are left alone.
    assert not one.choice.handle_asked(FunctionAsked("tasks", 1, "select", (1,)), 0)
    assert one.choice.next_event() is None


def test_choice_and_confirmation_are_told_again_after_a_while_and_at_once_if_new(one):
    choice, follower = one.choice, one.follower
    assert choice.poll_timeout() == 0
    assert one.publish(0)
    assert choice.poll_choice(AGAIN_NS - 1) is None
    assert choice.poll_timeout() == AGAIN_NS
    assert choice.poll_choice(AGAIN_NS) == Choice(0, "stereo")
    assert follower.poll_confirmed(7) == 0
    assert follower.poll_confirmed(7 + AGAIN_NS - 1) is None
    assert follower.poll_confirmed(7 + AGAIN_NS) == 0
    one.ask("static", 1, AGAIN_NS + 1)
    assert choice.poll_timeout() == 0
    assert choice.poll_choice(AGAIN_NS + 1) == Choice(AGAIN_NS + 1, "static")


def test_a_session_knows_its_cameras_and_numbers_their_pictures_without_a_gap():
    dictionary = built_in_dictionary()
    anyone, _ = dictionary.application("camera").parameters
    assert anyone.size == MAX_CAMERA_OCTETS
    topology = Topology(setup=BUILT_IN["spacejustin"])
    camera, _ = session_dictionary(built_in_dictionary(), topology).application("camera").parameters
    assert camera.unpack(camera.pack("static")) == "static"
    with pytest.raises(ConfigError, match=r"^unknown camera roof: choose one of stereo, static"):
        camera.pack("roof")
    follower = CameraFollower()
    numbers = []
    for number, camera in enumerate(("stereo", "static", "stereo")):
        follower.handle_choice(Choice(number, camera))
        numbers += [follower.restamp(CaptureStamp(0, 77, camera)).sequence for _ in range(2)]
    assert numbers == list(range(6))
