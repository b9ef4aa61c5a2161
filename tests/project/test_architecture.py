"""What may import what: the three packages in one direction, and no clock or socket in a core."""

import ast

import pytest
from places import ROOT

#: A package may import itself and those before it.
ORDER = ("kontur_av", "telepresence", "pipelines")

#: The rooms of `pipelines`: a module may import its own tier and those before it.
TIERS = (
    {"setup"},
    {"topology"},
    {"cores"},
    {"runtime"},
    {"parts"},
    {"simulation", "report"},
    {"commands", "bench"},
)
#: The number of modules allowed in the root of `pipelines`.
MOST_IN_THE_ROOT = 6

#: Modules with I/O, time or randomness. A core gets these as arguments.
DOORS = {
    "asyncio",
    "concurrent",
    "datetime",
    "evdev",
    "multiprocessing",
    "os",
    "secrets",
    "select",
    "selectors",
    "signal",
    "socket",
    "subprocess",
    "threading",
    "time",
}

#: Every module in this folder is the shell of a process.
PROCESSES = "pipelines/parts/"

#: Other modules that may import one of DOORS, with the reason. All others are cores.
SHELLS = {
    "kontur_av/topics/notifier.py": "FIFOs, and sleep",
    "kontur_av/clock.py": "the one place that asks for the time",
    "kontur_av/topics/session_files.py": "files and shared memory",
    "kontur_av/sources/camera.py": "a device",
    "kontur_av/sources/microphone.py": "a device",
    "kontur_av/sources/pipe.py": "a FIFO",
    "pipelines/bench/all/run.py": "runs commands, and asks for the date",
    "pipelines/bench/children.py": "ends processes",
    "pipelines/bench/fanout/gstreamer.py": "a library that starts threads, and files",
    "pipelines/bench/fanout/run.py": "processes",
    "pipelines/bench/fanout/ways.py": "asks for the process's number",
    "pipelines/bench/latency/runs.py": "tries the clock",
    "pipelines/bench/machine.py": "asks the system what it is",
    "pipelines/bench/haptics/grid.py": "processes",
    "pipelines/bench/link/live.py": "runs commands",
    "pipelines/bench/passes/run.py": "runs commands",
    "pipelines/bench/session.py": "runs commands",
    "pipelines/bench/video/clips.py": "shared memory",
    "pipelines/bench/video/contenders.py": "runs commands",
    "pipelines/bench/video/ends.py": "processes, FIFOs and sockets",
    "pipelines/bench/video/run.py": "sockets, and sleep",
    "pipelines/bench/voice/gstreamer.py": "runs commands and listens to them",
    "pipelines/cli.py": "the command itself",
    "pipelines/commands/common.py": "addresses, files and signals of a command",
    "pipelines/runtime/control.py": "the control socket",
    "pipelines/runtime/datagrams.py": "the sockets of a gateway",
    "pipelines/runtime/gateway_ports.py": "the sockets of a gateway",
    "pipelines/commands/devices.py": "asks the system for its devices",
    "pipelines/commands/doctor.py": "asks the system for everything",
    "kontur_av/streams/encoding_thread.py": "a thread",
    "kontur_av/streams/udp.py": "sockets",
    "pipelines/runtime/launcher.py": "processes",
    "pipelines/commands/link.py": "a command",
    "pipelines/runtime/process.py": "what every process has",
    "pipelines/commands/raw_pictures.py": "a file or a FIFO",
    "pipelines/commands/receive.py": "a command",
    "pipelines/report/report_file.py": "a file",
    "pipelines/commands/send.py": "a command",
    "pipelines/commands/send_media.py": "random numbers of a stream",
    "pipelines/runtime/sessions.py": "processes, and what they leave",
    "pipelines/simulation/workers.py": "processes",
    "pipelines/commands/receive_media.py": "a random number of a receiver",
    "pipelines/commands/stream.py": "a command",
    "telepresence/haptics/device/gamepad.py": "a device",
}


#: Folders whose every module is a shell.
SHELL_FOLDERS = (PROCESSES, "pipelines/bench/", "pipelines/commands/", "pipelines/runtime/")

#: Modules that a core may import: they compute, and do no I/O.
PURE = {
    "__future__",
    "array",
    "base64",
    "binascii",
    "bisect",
    "collections",
    "contextlib",
    "dataclasses",
    "difflib",
    "enum",
    "fractions",
    "functools",
    "hashlib",
    "heapq",
    "importlib",
    "ipaddress",
    "itertools",
    "math",
    "numpy",
    "operator",
    "queue",
    "random",
    "re",
    "statistics",
    "string",
    "struct",
    "textwrap",
    "types",
    "typing",
    "weakref",
}

#: Further libraries that cores use, with the reason.
LIBRARIES = {
    "kontur_av/codecs/": ({"av", "cv2"}, "FFmpeg's coders, and scaling of pictures"),
    "kontur_av/codecs/libopus.py": ({"ctypes", "pathlib", "sys", "warnings"}, "finds libopus"),
    "kontur_av/detect/light.py": ({"cv2"}, "looks at pictures"),
    "kontur_av/codecs/opus.py": ({"ctypes"}, "calls libopus"),
    "kontur_av/rtp/modules.py": ({"sys"}, "the table of modules"),
    "kontur_av/rtp/wire.py": ({"aiortc"}, "RTP and RTCP, octets only"),
    "kontur_av/sources/file.py": ({"av", "pathlib"}, "a file"),
    "kontur_av/sources/fit.py": ({"av"}, "scales a picture"),
    "kontur_av/topics/bus.py": ({"ctypes", "iceoryx2"}, "shared memory"),
    "telepresence/link/radio/orbit.py": ({"sgp4"}, "the model of orbits"),
    "telepresence/link/radio/profile_file.py": ({"pathlib"}, "a file"),
    "telepresence/toml_file.py": ({"msgspec", "pathlib", "tomllib"}, "a file"),
    "telepresence/world/": ({"cv2"}, "draws"),
    "telepresence/world/speech.py": ({"av", "pathlib"}, "files"),
    "pipelines/cores/probe.py": ({"pickle"}, "a message as octets"),
    "pipelines/setup/setup_file.py": ({"pathlib"}, "a file"),
    "pipelines/cores/requests.py": ({"msgspec"}, "requests and answers as JSON"),
    "pipelines/report/": ({"msgspec", "rich"}, "the report as JSON and as text"),
    "pipelines/report/keys.py": ({"inspect"}, "reads docstrings"),
    "pipelines/report/live.py": ({"sys"}, "the terminal"),
    "pipelines/report/model.py": ({"json", "pathlib"}, "the report's file"),
    "pipelines/simulation/session.py": ({"msgspec"}, "copies a part of the report"),
}


def library(module: str) -> set[str]:
    """What `module` may import by LIBRARIES."""
    names: set[str] = set()
    for place, (libraries, _) in LIBRARIES.items():
        if module.startswith(place):
            names |= libraries
    return names


def modules() -> list[str]:
    found = [path for package in ORDER for path in (ROOT / package).rglob("*.py")]
    return sorted(path.relative_to(ROOT).as_posix() for path in found)


def imported(module: str) -> set[str]:
    """Top-level names of all packages that a module imports, within functions too."""
    names: set[str] = set()
    for node in ast.walk(ast.parse((ROOT / module).read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            # A relative import would hide where it leads.
            names.add((node.module or "").partition(".")[0] if not node.level else ".")
    return names


@pytest.mark.parametrize("package", ORDER)
def test_imports_run_one_way(package):
    later = {*ORDER[ORDER.index(package) + 1 :], "."}
    wrong = {
        module: found
        for module in modules()
        if module.startswith(f"{package}/") and (found := imported(module) & later)
    }
    assert not wrong


def rooms_of_pipelines(module: str) -> set[str]:
    """The rooms of `pipelines` that a module imports, within functions too."""
    names: set[str] = set()
    for node in ast.walk(ast.parse((ROOT / module).read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    found = {tuple(name.split(".")[:2]) for name in names}
    return {room for package, *rest in found for room in rest if package == "pipelines"}


@pytest.mark.parametrize("tier", range(len(TIERS)), ids=lambda tier: "-".join(sorted(TIERS[tier])))
def test_imports_of_pipelines_run_one_way(tier):
    above = set().union(*TIERS[tier + 1 :])
    wrong = {
        module: found
        for module in modules()
        for room in TIERS[tier]
        if module.startswith(f"pipelines/{room}/") and (found := rooms_of_pipelines(module) & above)
    }
    assert not wrong


def test_every_room_of_pipelines_has_its_tier():
    rooms = {path.parent.name for path in (ROOT / "pipelines").glob("*/__init__.py")}
    assert rooms == set().union(*TIERS)
    in_the_root = {path.name for path in (ROOT / "pipelines").glob("*.py")}
    assert len(in_the_root) <= MOST_IN_THE_ROOT


def test_cores_import_only_what_is_allowed():
    wrong = {
        module: found
        for module in modules()
        if module not in SHELLS
        and not module.startswith(SHELL_FOLDERS)
        and (found := imported(module) - {*ORDER, *PURE, *library(module)})
    }
    assert not wrong, "a core is given the time and the octets; a new shell is named in SHELLS"


def test_the_list_of_libraries_has_no_unused_entry():
    used = {place: set() for place in LIBRARIES}
    for module in modules():
        for place in LIBRARIES:
            if module.startswith(place):
                used[place] |= imported(module)
    assert {place for place, (names, _) in LIBRARIES.items() if not names <= used[place]} == set()


def test_the_list_of_shells_has_no_core():
    assert {module for module in SHELLS if not imported(module) & DOORS} == set()
