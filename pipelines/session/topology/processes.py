"""The names of processes by which other modules know them."""

from pipelines.session.setup.segments import Segment

ROBOT, JOYSTICK = "robot", "joystick"
#: The arm that only a partner drives, and who hands the robot over.
SECOND_ROBOT, OWNER_DESK = "robot_second", "owner_desk"
#: Telecommands and telemetry of the ground and of space.
SELECTOR, CONSOLE = "selector", "console"
#: TOP kernel and experiment, the LED panel, the mission control panel.
TASKS, LEDS, PANEL = "tasks", "leds", "panel"


def component_process(name: str) -> str:
    """The process of a user's component in telemetry."""
    return f"telemetry_{name}"


#: The process that takes a trainer's requests.
TRAINER = "trainer"
#: The process that records the session.
RECORDER = "recorder"
#: By segment: the process that serves its browser pages.
PAGES = {segment: f"page_{segment.value}" for segment in Segment}
#: The process that has the connections to partners, and the one that shows the partner.
RTC, RTC_DISPLAY = "rtc", "rtc_display"
