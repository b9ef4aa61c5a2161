"""The radio link and the hand: what shares the channel with the media.

All are cores: they open no socket and ask no clock. samples/slots_virtual_time.py drives both ends
of the link by hand. `RobotDevice` and `JoystickDevice` are what a robot and a joystick of your own
are (docs/drivers.md).
"""

from typing import TYPE_CHECKING

from kontur_av.lazy import lazy_names

if TYPE_CHECKING:
    from telepresence.haptics.axes import AxisCapabilities, AxisReading
    from telepresence.haptics.bilateral import Handle, HeldJoystick, JoystickSide, RobotSide
    from telepresence.haptics.board import WALL_X_M
    from telepresence.haptics.device.device import (
        JoystickCapabilities,
        JoystickDevice,
        JoystickReading,
    )

    # `JoystickFacts` and `RobotFacts` are former names, for drivers written for 0.1.0.
    from telepresence.haptics.device.device import JoystickCapabilities as JoystickFacts
    from telepresence.haptics.device.states import JoystickState
    from telepresence.haptics.hand import FIRM_GRIP, SOFT_GRIP, Hand, Waypoint
    from telepresence.haptics.robot import JointReading, Mark, RobotCapabilities
    from telepresence.haptics.robot import RobotCapabilities as RobotFacts
    from telepresence.haptics.robot_device import RobotDevice, RobotReading
    from telepresence.haptics.sample import Command, Feedback
    from telepresence.link.flows import (
        Flow,
        HapticReceived,
        Level,
        packet_flow,
        video_flow,
        voice_flow,
    )
    from telepresence.link.gateway import Gateway
    from telepresence.link.profile import DOWNLINK, UPLINK, LinkProfile
    from telepresence.link.radio import RadioPath, RadioProfile, load_radio
    from telepresence.link.receiver import LinkReceiver
    from telepresence.link.sender import LinkSender
    from telepresence.tmtc.pus.application import PusApplication
    from telepresence.tmtc.pus.user import EventReport, PusUser
    from telepresence.tmtc.telemetry_source import (
        FunctionCall,
        TelemetryEvent,
        TelemetryFunction,
        TelemetryParameter,
        TelemetryReading,
        TelemetrySource,
    )
    from telepresence.world import WorldState, render, video_scenes

__all__ = [
    "DOWNLINK",
    "FIRM_GRIP",
    "SOFT_GRIP",
    "UPLINK",
    "WALL_X_M",
    "AxisCapabilities",
    "AxisReading",
    "Command",
    "EventReport",
    "Feedback",
    "Flow",
    "FunctionCall",
    "Gateway",
    "Hand",
    "Handle",
    "HapticReceived",
    "HeldJoystick",
    "JointReading",
    "JoystickCapabilities",
    "JoystickDevice",
    "JoystickFacts",
    "JoystickReading",
    "JoystickSide",
    "JoystickState",
    "Level",
    "LinkProfile",
    "LinkReceiver",
    "LinkSender",
    "Mark",
    "PusApplication",
    "PusUser",
    "RadioPath",
    "RadioProfile",
    "RobotCapabilities",
    "RobotDevice",
    "RobotFacts",
    "RobotReading",
    "RobotSide",
    "TelemetryEvent",
    "TelemetryFunction",
    "TelemetryParameter",
    "TelemetryReading",
    "TelemetrySource",
    "Waypoint",
    "WorldState",
    "load_radio",
    "packet_flow",
    "render",
    "video_flow",
    "video_scenes",
    "voice_flow",
]

__getattr__, __dir__ = lazy_names(__name__)
