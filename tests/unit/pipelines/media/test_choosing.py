"""A selection is acknowledged when no picture of another camera is coded or sent any more."""

from kontur_av.media import CaptureStamp
from pipelines.media.choosing import CameraChoice
from pipelines.media.following import (
    CHOICE_OCTETS,
    CameraFollower,
    Choice,
    pack_confirmed,
    unpack_confirmed,
)
from pipelines.session.probe import Probe
from pipelines.session.setup.built_in import BUILT_IN
from telepresence.tmtc import SelectAck, SelectCamera, pack_packet, parse_packet

SETUP = BUILT_IN["spacejustin"]


def choice_at(now_ns, selected=""):
    return CameraChoice(SETUP, Probe(), now_ns=now_ns, selected=selected)


def acknowledged(choice, now_ns):
    """The acknowledged tokens, each with its success."""
    found = {}
    while (packet := choice.poll_transmit(now_ns)) is not None:
        message = parse_packet(packet).message
        if isinstance(message, SelectAck):
            found[message.token] = message.ok
    return found


def ask(choice, camera, token, now_ns):
    return choice.handle_packet(pack_packet(SelectCamera(camera, token), token), now_ns)


def test_the_acknowledgement_waits_until_the_sender_has_left_the_camera():
    choice, follower = choice_at(0), CameraFollower()
    assert follower.handle_choice(choice.choice)
    choice.handle_confirmed(follower.confirmed, 1)
    assert ask(choice, "static", 1, 10)
    assert acknowledged(choice, 10) == {}
    assert follower.handle_choice(choice.choice)
    assert follower.camera == "static"
    assert follower.leaving and follower.confirmed is None
    assert not follower.handle_sender(idle=False)
    # A repeated telecommand is not acknowledged earlier.
    assert not ask(choice, "static", 1, 20)
    assert acknowledged(choice, 20) == {}
    assert follower.handle_sender(idle=True)
    choice.handle_confirmed(follower.confirmed, 30)
    assert acknowledged(choice, 30) == {1: True}
    # The camera is already selected.
    assert not ask(choice, "static", 2, 40)
    assert acknowledged(choice, 40) == {2: True}
    assert not ask(choice, "nowhere", 3, 50)
    assert acknowledged(choice, 50) == {3: False}


def test_an_old_confirmation_acknowledges_nothing_new():
    choice, follower = choice_at(0), CameraFollower()
    follower.handle_choice(choice.choice)
    first = follower.confirmed
    ask(choice, "static", 1, 10)
    ask(choice, "stereo", 2, 11)
    choice.handle_confirmed(first, 12)
    assert acknowledged(choice, 12) == {}
    follower.handle_choice(choice.choice)
    choice.handle_confirmed(follower.confirmed, 13)
    assert acknowledged(choice, 13) == {1: True, 2: True}


def test_a_restarted_selector_waits_for_its_own_number():
    before, follower = choice_at(0), CameraFollower()
    follower.handle_choice(before.choice)
    old = follower.confirmed
    # It was killed after it kept the choice and before it published it.
    after = choice_at(1000, "static")
    after.handle_confirmed(old, 1001)
    ask(after, "static", 5, 1002)
    assert acknowledged(after, 1002) == {}
    follower.handle_choice(after.choice)
    assert follower.leaving
    follower.handle_sender(idle=True)
    after.handle_confirmed(follower.confirmed, 1003)
    assert acknowledged(after, 1003) == {5: True}


def test_a_restarted_sender_confirms_the_first_choice_that_it_receives():
    choice = choice_at(0)
    ask(choice, "static", 1, 10)
    successor = CameraFollower()
    assert successor.confirmed is None
    assert successor.handle_choice(choice.choice)
    choice.handle_confirmed(successor.confirmed, 20)
    assert acknowledged(choice, 20) == {1: True}


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
