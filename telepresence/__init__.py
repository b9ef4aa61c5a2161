"""The radio link and the hand: what shares the channel with the media.

All are cores: they open no socket and ask no clock. samples/slots_virtual_time.py drives both ends
of the link by hand.
"""

from typing import TYPE_CHECKING

from kontur_av.lazy import lazy_names

if TYPE_CHECKING:
    from telepresence.haptics.bilateral import JoystickSide, RobotSide
    from telepresence.haptics.sample import Command, Feedback
    from telepresence.link.flows import Flow, Level, packet_flow, video_flow, voice_flow
    from telepresence.link.gateway import Gateway
    from telepresence.link.profile import LinkProfile
    from telepresence.link.radio import RadioPath, RadioProfile, load_radio
    from telepresence.link.receiver import LinkReceiver
    from telepresence.link.sender import LinkSender
    from telepresence.tmtc.pus.application import PusApplication
    from telepresence.tmtc.pus.user import PusUser

__all__ = [
    "Command",
    "Feedback",
    "Flow",
    "Gateway",
    "JoystickSide",
    "Level",
    "LinkProfile",
    "LinkReceiver",
    "LinkSender",
    "PusApplication",
    "PusUser",
    "RadioPath",
    "RadioProfile",
    "RobotSide",
    "load_radio",
    "packet_flow",
    "video_flow",
    "voice_flow",
]

__getattr__, __dir__ = lazy_names(__name__)
