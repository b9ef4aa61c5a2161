"""A component of your own in a session's telemetry: a battery that sinks and can be recharged.

    kontur-av stream --setup taskboard --telemetry own_telemetry:Battery

in this file's directory; then `kontur-av tc battery get voltage`, `tc battery recharge 12.5`.
"""

import telepresence as tp


class Battery(tp.TelemetrySource):
    name, text = "battery", "the battery of the robot"
    parameters = (
        tp.TelemetryParameter(name="voltage", unit="V", low=11, high=13, below="low", period_s=2),
        tp.TelemetryParameter(name="target", unit="V", low=12, high=13, period_s=None),
    )
    events = (tp.TelemetryEvent(name="low", severity="medium", arguments=("voltage",)),)
    functions = (tp.TelemetryFunction(name="recharge", arguments=("target",), text="to a voltage"),)
    voltage_v = 12.0

    def read(self):
        self.voltage_v -= 0.1
        return tp.TelemetryReading({"voltage": self.voltage_v})

    def call(self, function, arguments):
        self.voltage_v = arguments["target"]

    def handle_event(self, event):
        if (event.application, event.event) == ("battery", "low"):
            yield tp.FunctionCall("battery", "recharge", (12.5,))
