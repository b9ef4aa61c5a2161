"""A selection is completed when no picture of another camera is coded or sent any more."""

import pytest

from kontur_av.errors import ConfigError
from kontur_av.media import CaptureStamp
from pipelines.media.following import (
    AGAIN_NS,
    CHOICE_OCTETS,
    CameraFollower,
    Choice,
    pack_confirmed,
    unpack_confirmed,
)
from pipelines.mission.choosing import CameraChoice
from pipelines.mission.supervisor import session_dictionary
from pipelines.mission.tmtc_messages import FunctionAsked, FunctionDone, SetValues
from pipelines.session.probe import Probe
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.session.setup.table import MAX_CAMERA_OCTETS
from pipelines.session.topology import Topology
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary

CAMERAS = BUILT_IN["spacejustin"].cameras
SUPERSEDED = "a later request came"


def choice_at(now_ns, selected=""):
    return CameraChoice(CAMERAS, Probe(), now_ns=now_ns, selected=selected)


def told(choice, follower, now_ns):
    """The sender hears the choice; True if it is to follow another camera."""
    return follower.handle_choice(choice.poll_choice(now_ns))


def confirm(choice, follower, now_ns):
    choice.handle_confirmed(follower.poll_confirmed(now_ns))


def answered(choice):
    """By token: why it was refused, or ""."""
    found = {}
    while (request := choice.next_event()) is not None:
        if isinstance(request, FunctionDone):
            found[request.token] = request.refusal
    return found


def ask(choice, camera, token, now_ns):
    return choice.handle_asked(FunctionAsked("camera", token, "select", (camera,)), now_ns)


def test_the_completion_waits_until_the_sender_has_left_the_camera():
    choice, follower = choice_at(0), CameraFollower()
    assert told(choice, follower, 0)
    confirm(choice, follower, 1)
    assert choice.next_event() == SetValues("camera", {"camera": "stereo"})
    assert ask(choice, "static", 1, 10)
    assert choice.next_event() is None
    assert told(choice, follower, 10)
    assert follower.camera == "static"
    assert follower.leaving and follower.poll_confirmed(11) is None
    assert not follower.handle_sender(idle=False)
    # Another telecommand for the same camera is not completed earlier.
    assert not ask(choice, "static", 2, 20)
    assert choice.next_event() is None
    assert follower.handle_sender(idle=True)
    confirm(choice, follower, 30)
    assert choice.next_event() == SetValues("camera", {"camera": "static"})
    assert answered(choice) == {1: "", 2: ""}
    # The camera is already selected.
    assert not ask(choice, "static", 3, 40)
    assert answered(choice) == {3: ""}
    assert not ask(choice, "nowhere", 4, 50)
    assert answered(choice) == {4: f"unknown camera nowhere: choose one of {', '.join(CAMERAS)}"}


def test_a_later_request_ends_an_earlier_one():
    choice, follower = choice_at(0), CameraFollower()
    told(choice, follower, 0)
    first = follower.poll_confirmed(0)
    ask(choice, "static", 1, 10)
    ask(choice, "head", 2, 11)
    assert answered(choice) == {1: SUPERSEDED}
    # An old confirmation completes nothing new.
    choice.handle_confirmed(first)
    assert answered(choice) == {}
    told(choice, follower, 12)
    follower.handle_sender(idle=True)
    confirm(choice, follower, 13)
    assert answered(choice) == {2: ""}
    # A task on the ground does so, too.
    ask(choice, "static", 3, 20)
    assert choice.select("stereo", 21)
    assert answered(choice) == {3: SUPERSEDED}
    assert not choice.select("stereo", 22)
    assert not choice.select("nowhere", 23)


def test_a_restarted_selector_waits_for_its_own_number():
    before, follower = choice_at(0), CameraFollower()
    told(before, follower, 0)
    old = follower.poll_confirmed(0)
    # It was killed after it kept the choice and before it published it.
    after = choice_at(1000, "static")
    after.handle_confirmed(old)
    ask(after, "static", 5, 1002)
    assert answered(after) == {}
    told(after, follower, 1002)
    assert follower.leaving
    follower.handle_sender(idle=True)
    confirm(after, follower, 1003)
    assert answered(after) == {5: ""}


def test_a_restarted_sender_confirms_the_first_choice_that_it_receives():
    choice = choice_at(0)
    ask(choice, "static", 1, 10)
    successor = CameraFollower()
    assert successor.poll_confirmed(10) is None
    assert told(choice, successor, 15)
    confirm(choice, successor, 20)
    assert answered(choice) == {1: ""}


def test_choice_and_confirmation_are_told_again_after_a_while_and_at_once_if_new():
    choice, follower = choice_at(0), CameraFollower()
    assert choice.poll_timeout() == 0
    assert told(choice, follower, 0)
    assert choice.poll_choice(AGAIN_NS - 1) is None
    assert choice.poll_timeout() == AGAIN_NS
    assert choice.poll_choice(AGAIN_NS) == Choice(0, "stereo")
    assert follower.poll_confirmed(7) == 0
    assert follower.poll_confirmed(7 + AGAIN_NS - 1) is None
    assert follower.poll_confirmed(7 + AGAIN_NS) == 0
    ask(choice, "static", 1, AGAIN_NS + 1)
    assert choice.poll_timeout() == 0
    assert choice.poll_choice(AGAIN_NS + 1) == Choice(AGAIN_NS + 1, "static")


def test_functions_of_other_applications_are_left_alone():
    choice = choice_at(0)
    assert not choice.handle_asked(FunctionAsked("tasks", 1, "select", (1,)), 0)
    assert choice.next_event() is None


def test_the_dictionary_of_a_session_knows_its_cameras():
    dictionary = built_in_dictionary()
    (anyone,) = dictionary.application("camera").parameters
    assert anyone.size == MAX_CAMERA_OCTETS
    topology = Topology(setup=BUILT_IN["spacejustin"])
    (camera,) = session_dictionary(built_in_dictionary(), topology).application("camera").parameters
    assert camera.unpack(camera.pack("static")) == "static"
    with pytest.raises(ConfigError, match=r"^unknown camera roof: choose one of stereo, static"):
        camera.pack("roof")


def test_pictures_of_all_cameras_are_numbered_without_a_gap():
    follower = CameraFollower()
    numbers = []
    for number, camera in enumerate(("stereo", "static", "stereo")):
        follower.handle_choice(Choice(number, camera))
        numbers += [follower.restamp(CaptureStamp(0, 77, camera)).sequence for _ in range(2)]
    assert numbers == list(range(6))


def test_choices_and_confirmations_survive_packing():
    choice = Choice(1 << 60, "c" * 64)
    assert Choice.unpack(choice.pack()) == choice
    assert len(choice.pack()) <= CHOICE_OCTETS
    assert unpack_confirmed(pack_confirmed(1 << 60)) == 1 << 60
