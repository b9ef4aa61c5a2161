"""Comparisons with peers and between versions: `python -m benchmarks NAME`. Not in the wheel.

A benchmark is a folder of its name whose `command.py` has `add_arguments(parser)` and `run(args)`,
as a bench of `kontur-av bench`; the exit codes are the same.
"""

#: What can be measured, and what it is about.
BENCHMARKS = {
    "all": "every bench, often enough to know its spread, and the page of measurements",
    "haptics": "the hand on virtual time: energy, force and stability over a grid of radios",
    "page": "the browser pages: topic to pixel beside WebRTC, pointer to hand, cost of a session",
    "record": "a recording: what a kill and a cut file lose, and what it costs the session",
    "rtc": "the leg to a partner: capture to a browser's pixel, reception, what the radio notices",
    "video": "pictures through a thin channel, beside those of GStreamer and Chromium",
    "voice": "speech through a lossy network: mouth to ear, rate and quality, beside GStreamer's",
}
