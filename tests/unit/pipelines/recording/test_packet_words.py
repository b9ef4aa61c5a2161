"""What a recording says about a packet has the names of the dictionary."""

from hypothesis import given
from hypothesis import strategies as st

from pipelines.recording.packet_words import PacketWords
from telepresence.haptics.mediated.wall import Wall, WallMessage, pack_wall
from telepresence.tmtc.k2aci import Acknowledgement, Numbered, TaskSelected, pack_body
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary
from telepresence.tmtc.pus.node import K2ACI_SERVICE, K2ACI_SUBTYPE
from telepresence.tmtc.pus.packets import Telecommand, Telemetry, pack_packet
from telepresence.tmtc.pus.verification import (
    Failure,
    Verification,
    VerificationStage,
    pack_verification,
)


def command(apid, service, subtype, data=b""):
    packet = Telecommand(apid=apid, count=5, service=service, subtype=subtype, data=data)
    return pack_packet(packet)


def report(apid, service, subtype, data=b""):
    packet = Telemetry(apid=apid, count=9, service=service, subtype=subtype, data=data)
    return pack_packet(packet)


def test_packets_read_by_the_names_of_the_dictionary_and_never_by_numbers_it_has():
    of = PacketWords(built_in_dictionary()).of
    refused = Verification(0x120, 5, VerificationStage.STARTED, Failure.REFUSED, "it is hot")
    done = Verification(0x120, 5, VerificationStage.COMPLETED)
    task = Numbered(1, 2, 2, TaskSelected(task="aiming", run=3, start_um=(10, -20)))
    wall = WallMessage(1, Wall(0.5, 0.06, 1500.0))
    for packet, words in (
        (
            report(0x120, 1, 7, pack_verification(done)),
            "PUS 1,7 joystick: telecommand 5: completed",
        ),
        (command(0x120, 8, 1, b"\3"), "PUS 8,1 joystick: stop"),
        (report(0x120, 1, 7, pack_verification(done)), "PUS 1,7 joystick: stop: completed"),
        (
            report(0x120, 1, 4, pack_verification(refused)),
            "PUS 1,4 joystick: stop: not started: it is hot",
        ),
        (command(0x133, 8, 1, b"\1static".ljust(12, b"\0")), "PUS 8,1 camera: select static"),
        (command(0x120, 8, 1, b"\xff"), "PUS 8,1 joystick: unknown function 255"),
        (command(0x120, 3, 6, b"\1\2"), "PUS 3,6 joystick: report handle off"),
        (command(0x120, 3, 27, b"\1\1"), "PUS 3,27 joystick: get state"),
        (command(0x131, 17, 1), "PUS 17,1 robot: are you alive"),
        (report(0x120, 5, 1, b"\1\4"), "PUS 5,1 joystick: event state_changed: state halted"),
        (report(0x122, 3, 25, b"\1\6\0\0\0\3"), "PUS 3,25 panel: state: mode running, run 3"),
        (report(0x122, 3, 25, b"\1"), "PUS 3,25 panel: malformed"),
        (report(0x7FE, 3, 25, b"\1"), "PUS 3,25 application 0x7fe: report"),
        (
            report(0x132, K2ACI_SERVICE, K2ACI_SUBTYPE, pack_body(task)),
            "PUS 129,1 tasks: task_selected: task aiming, run 3, start_um 10/-20",
        ),
        (
            report(0x122, K2ACI_SERVICE, K2ACI_SUBTYPE, pack_body(Acknowledgement(1, 2))),
            "PUS 129,1 panel: acknowledges 2",
        ),
        (pack_wall(WallMessage(1, None), 0), "no wall"),
        (pack_wall(wall, 0), "wall at 0.0600 m towards 28.6°, 1500 N/m"),
        (b"\x08\x01", "unknown"),
    ):
        assert of(packet) == words


MESSAGES = [(1, 4), (1, 7), (3, 5), (3, 25), (5, 1), (8, 1), (12, 1), (17, 2), (20, 2), (20, 3)]


@given(
    st.sampled_from((command, report)),
    st.sampled_from((0x120, 0x131, 0x7FE)),
    st.sampled_from((*MESSAGES, (K2ACI_SERVICE, 1), (200, 9))),
    st.binary(max_size=40),
)
def test_malformed_packets_have_words_too(kind, apid, message, data):
    assert PacketWords(built_in_dictionary()).of(kind(apid, *message, data))
