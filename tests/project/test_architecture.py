"""What may import what: the three packages in one direction, and no clock or socket in a core."""

import ast
import re

import pytest
from places import ROOT, imports_of

#: A package may import itself and those before it.
ORDER = ("kontur_av", "telepresence", "pipelines")

#: The rooms of `pipelines`: a module may import its own room and those of the tiers before it.
TIERS = (
    {"session"},
    {"media", "link"},
    {"hand"},
    {"mission"},
    {"recording", "partner", "seats"},
    {"report"},
    {"packets", "ros2", "foxglove", "study", "files"},
    {"virtual", "upkeep"},
    {"bench"},
    {"commands"},
)
#: The number of modules allowed in the root of `pipelines`.
MOST_IN_THE_ROOT = 6

#: Modules with I/O, time or randomness. A core gets these as arguments.
DOORS = {
    "asyncio",
    "concurrent",
    "datetime",
    "evdev",
    "ftplib",
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

#: Every module of this name is the shell of a process.
PROCESS = re.compile(r"pipelines/(?!report/)\w+/process_\w+\.py")

#: Other modules that may import one of DOORS, with the reason. All others are cores.
SHELLS = {
    "kontur_av/topics/notifier.py": "FIFOs, and sleep",
    "kontur_av/topics/file_node.py": "files in shared memory",
    "kontur_av/topics/iceoryx_node.py": "shared memory",
    "kontur_av/clock.py": "the one place that asks for the time",
    "kontur_av/topics/session_files.py": "files and shared memory",
    "kontur_av/sources/camera.py": "a device",
    "kontur_av/sources/microphone.py": "a device",
    "kontur_av/sources/pipe.py": "a FIFO",
    "pipelines/upkeep/archive.py": "a database",
    "pipelines/upkeep/sequence_runner.py": "runs commands beside a session, and a log",
    "pipelines/session/command_process.py": "ends processes, and writes to standard output",
    "pipelines/session/web_site.py": "the sockets of visitors",
    "pipelines/bench/latency.py": "tries the clock",
    "pipelines/bench/link.py": "runs commands",
    "pipelines/bench/session.py": "runs commands",
    "pipelines/bench/video/clips.py": "shared memory",
    "pipelines/bench/video/contenders.py": "runs commands",
    "pipelines/bench/course/ends.py": "processes, FIFOs and sockets",
    "pipelines/bench/video/command.py": "sockets, and sleep",
    "pipelines/virtual/campaign/sessions.py": "processes, a cluster, and asks for the time",
    "pipelines/cli.py": "the command itself",
    "pipelines/session/datagrams.py": "sockets, and names of hosts",
    "pipelines/link/process_gateway.py": "the sockets of a gateway",
    "pipelines/partner/whip.py": "a process and sockets",
    "pipelines/media/input_devices.py": "asks the system for its devices",
    "pipelines/session/machine_checks.py": "asks the system for everything",
    "kontur_av/streams/encoding_thread.py": "a thread",
    "kontur_av/streams/udp.py": "sockets",
    "pipelines/session/launcher.py": "processes",
    "pipelines/session/serving_loop.py": "an event loop",
    "pipelines/link/own_ends.py": "sockets that hold ports",
    "pipelines/session/process.py": "what every process has",
    "pipelines/recording/raw_pictures.py": "a file or a FIFO",
    "pipelines/recording/live_output.py": "a process that connects",
    "pipelines/recording/received_media.py": "a command's loop",
    "pipelines/partner/coded_sources.py": "an event loop, and threads",
    "pipelines/media/key_picture_maker.py": "a thread",
    "pipelines/seats/process_page.py": "the sockets of browsers",
    "pipelines/study/running.py": "files, and the sockets of a browser",
    "pipelines/report/process_metrics.py": "the sockets of a monitoring system",
    "pipelines/seats/seat_sockets.py": "the sockets of browsers",
    "pipelines/seats/upkeep_watch.py": "sockets of other processes, and files they keep",
    "pipelines/seats/seat_topics.py": "topics on an event loop, a thread that codes",
    "pipelines/session/terminals.py": "Unix sockets",
    "pipelines/recording/part_files.py": "files and threads",
    "pipelines/report/report_file.py": "files, and the terminal",
    "pipelines/partner/peer.py": "an event loop, random numbers of streams",
    "pipelines/partner/samples.py": "an event loop",
    "pipelines/partner/server.py": "the sockets of partners",
    "pipelines/partner/transport.py": "the sockets of ICE",
    "pipelines/media/sending.py": "a command's loop",
    "kontur_av/streams/feeds.py": "random numbers of a stream",
    "kontur_av/streams/decoding.py": "a random number of a receiver",
    "kontur_av/streams/ends.py": "threads and sockets",
    "pipelines/mission/joined_session.py": "topics and a Unix socket",
    "pipelines/files/process_files.py": "files",
    "pipelines/files/service_sockets.py": "TCP connections",
    "pipelines/session/sessions.py": "processes, and what they leave",
    "pipelines/virtual/workers.py": "processes",
    "pipelines/virtual/campaign/sweep_file.py": "files, and asks for the time",
    "pipelines/commands/live_session.py": "the live commands",
    "telepresence/haptics/device/gamepad.py": "a device",
    "telepresence/haptics/udp_line.py": "a socket, and random numbers of a session",
    "telepresence/private_file.py": "files",
    "pipelines/hand/partner_arm.py": "a loop of 1 kHz and its socket",
    "pipelines/hand/haptic_loop.py": "the 1 kHz loop and its sockets",
    "pipelines/link/key_files.py": "key files",
    "pipelines/mission/tmtc_socket.py": "a Unix socket, and patience",
    "pipelines/upkeep/desk.py": "a lock, files, and runs a program",
    "pipelines/upkeep/loader_keeper.py": "runs a program, and sockets",
    "pipelines/upkeep/version_keeper.py": "runs a program",
    "pipelines/session/served_pages.py": "files, and a browser",
    "pipelines/session/page_sockets.py": "sockets, files, and random numbers of a key",
    "pipelines/media/process_receive.py": "files",
    "pipelines/mission/process_tasks.py": "the date, and files",
    "pipelines/mission/process_tmtc.py": "a Unix socket and topics",
}


#: Folders whose every module is a shell.
SHELL_FOLDERS = ("pipelines/commands/",)

#: Modules that read or write files. Cores are handed what is in them.
FILES = {
    "pipelines/session/kept_files.py",
    "kontur_av/sources/file.py",
    "kontur_av/sources/recording.py",
    "pipelines/report/charts.py",
    "pipelines/bench/video/contenders.py",
    "pipelines/bench/sync.py",
    "pipelines/virtual/campaign/sweep_file.py",
    "pipelines/recording/export/films.py",
    "pipelines/recording/export/lerobot.py",
    "pipelines/recording/export/table_files.py",
    "pipelines/recording/matroska.py",
    "pipelines/recording/recording_file.py",
    "pipelines/session/setup/setup_file.py",
    "telepresence/link/radio/profile_file.py",
    "telepresence/tmtc/pus/dictionary_file.py",
    "telepresence/tasks/task_files.py",
    "telepresence/toml_file.py",
    "telepresence/world/scenes.py",
}

#: Modules without a door of their own that use shells, and why.
USERS_OF_SHELLS = {
    "kontur_av/sources/looped.py": "waits for its next picture",
    "kontur_av/sources/source.py": "waits for a page",
    "kontur_av/sources/scene.py": "waits for its next picture",
    "kontur_av/sources/spec.py": "opens sources",
    "kontur_av/topics/bus.py": "shared memory",
    "pipelines/virtual/campaign/sweep.py": "draws charts",
    "pipelines/hand/device_check.py": "paces a device",
    "pipelines/hand/driver_checks.py": "paces a joystick",
    "pipelines/session/options.py": "opens radios that an option names",
    "pipelines/session/option_rows.py": "options of commands",
    "pipelines/session/setup/sources.py": "tries sources, and compares paths",
    "pipelines/virtual/simulate.py": "starts workers",
    "pipelines/report/charts.py": "draws charts",
    "pipelines/bench/link.py": "measures CPU time",
    "pipelines/session/web_site.py": "the files of pages, and TLS",
    "pipelines/report/live.py": "the terminal, and the launcher's processes",
    "pipelines/report/seat_feed.py": "the launcher's processes",
    "pipelines/virtual/media.py": "starts workers",
    "pipelines/virtual/streams.py": "workers encode and decode",
    "pipelines/virtual/mission.py": "the simulation's scene",
    "pipelines/virtual/session.py": "starts workers",
    "pipelines/virtual/studio.py": "what a worker does",
    "telepresence/haptics/specs.py": "opens joysticks and robots",
    "telepresence/haptics/udp_devices.py": "a socket",
    "telepresence/world/scenes.py": "opens scenes, and reads recorded speech",
    "pipelines/media/coded_topics.py": "topics",
    "pipelines/link/process_gateway.py": "topics",
    "pipelines/hand/process_ends.py": "topics",
    "pipelines/hand/safety_ends.py": "topics, and orders in files",
    "pipelines/hand/partner_arm.py": "sockets of a process",
    "pipelines/session/topic_ends.py": "topics",
    "pipelines/media/stream_figures.py": "sockets of a process",
    "pipelines/mission/tmtc_socket.py": "a Unix socket",
    "pipelines/recording/camera_reader.py": "a topic",
    "pipelines/recording/received_media.py": "decodes in real time, into files",
    "pipelines/recording/recorded_parts.py": "files",
    "pipelines/recording/replay_setup.py": "the files of recordings and setups",
}

#: What a core may import from a shell: constants, types, and conversions that ask nothing.
PURE_NAMES = {
    "kontur_av/sources/source.py": {"FILLED_BY_OTHERS", "PAGE", "TOPIC"},
    "telepresence/haptics/specs.py": {"PAGE", "ROS2_HAND", "SIMULATED", "is_simulated"},
    "kontur_av/clock.py": {
        "NS_PER_MS",
        "NS_PER_S",
        "NS_PER_US",
        "ntp_from_unix_ns",
        "unix_ns_from_ntp",
    },
}

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
    "shlex",
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
    "kontur_av/codecs/colours.py": ({"threading"}, "a scaler for each thread"),
    "kontur_av/codecs/libopus.py": ({"ctypes", "pathlib", "sys", "warnings"}, "finds libopus"),
    "kontur_av/detect.py": ({"cv2"}, "looks at pictures"),
    "kontur_av/sources/stereo.py": ({"cv2"}, "looks at pictures"),
    "kontur_av/lazy.py": ({"ast", "sys"}, "the table of modules, and what a package imports"),
    "kontur_av/rtp/wire.py": ({"aiortc"}, "RTP and RTCP, octets only"),
    "kontur_av/sources/file.py": ({"av", "pathlib"}, "a file"),
    "kontur_av/sources/fit.py": ({"av"}, "scales a picture"),
    "kontur_av/sources/looped.py": ({"av"}, "decoded pictures and their faults"),
    "kontur_av/sources/recorded_format.py": (
        {"lz4", "zstandard"},
        "unpacks chunks of recordings",
    ),
    "kontur_av/sources/recording.py": (
        {"google", "mcap", "pathlib", "struct"},
        "a file",
    ),
    "kontur_av/topics/bus.py": ({"ctypes"}, "shared memory"),
    "kontur_av/topics/iceoryx_node.py": ({"ctypes", "iceoryx2"}, "shared memory"),
    "telepresence/link/protection/": ({"cryptography"}, "keys and ciphers: octets only"),
    "telepresence/link/protection/agreement.py": ({"OpenSSL"}, "TLS in memory: octets only"),
    "telepresence/link/protection/handshake.py": ({"hmac"}, "nonces from a secret"),
    "telepresence/link/protection/identity.py": ({"datetime"}, "dates of a certificate; no clock"),
    "telepresence/link/protection/datagrams.py": ({"hmac"}, "codes, compared in constant time"),
    "telepresence/link/radio/orbit.py": (
        {"datetime", "sgp4"},
        "orbits and their calendar; no clock",
    ),
    "telepresence/haptics/udp_protocol.py": ({"hmac"}, "codes, compared in constant time"),
    "kontur_av/parts.py": ({"inspect", "pathlib", "sys"}, "a user's module"),
    "telepresence/link/radio/profile_file.py": ({"pathlib"}, "a file"),
    "telepresence/files/pdus.py": ({"spacepackets"}, "PDUs of CFDP: octets only"),
    "telepresence/tmtc/k2aci.py": ({"cbor2"}, "CBOR: octets only"),
    "telepresence/tmtc/pus/dictionary_file.py": ({"pathlib"}, "a file"),
    "telepresence/tmtc/pus/packets.py": ({"spacepackets"}, "PUS packets: octets only"),
    "telepresence/tmtc/pus/xtce": ({"xml"}, "writes XML as text"),
    "telepresence/tasks/reader.py": ({"xml"}, "parses octets; no document types"),
    "telepresence/tasks/task_files.py": ({"pathlib"}, "a file"),
    "telepresence/malformed.py": ({"msgspec"}, "its errors alone"),
    "telepresence/toml_file.py": ({"msgspec", "pathlib", "tomllib"}, "a file"),
    "telepresence/upkeep/inbox.py": (
        {"io", "msgspec", "tarfile", "zlib"},
        "what it tells, as JSON; an archive in memory",
    ),
    "telepresence/upkeep/manifest.py": ({"cryptography", "msgspec"}, "signatures and JSON: octets"),
    "telepresence/upkeep/version_stack.py": ({"msgspec"}, "the record as JSON"),
    "telepresence/world/": ({"cv2"}, "draws"),
    "pipelines/report/result.py": ({"pathlib"}, "writes a path as text"),
    "pipelines/bench/video/figures.py": ({"cv2"}, "compares pictures"),
    "telepresence/world/scenes.py": ({"av", "pathlib"}, "files"),
    "pipelines/session/probe.py": ({"pickle"}, "a message as octets"),
    "pipelines/session/setup/setup_file.py": ({"pathlib"}, "a file"),
    "pipelines/media/marking.py": ({"cv2"}, "draws"),
    "pipelines/hand/hand_topics.py": ({"msgspec"}, "requests, answers and states as octets"),
    "pipelines/session/figures.py": ({"msgspec"}, "events as JSON"),
    "pipelines/report/exposition.py": ({"msgspec", "prometheus_client"}, "metrics as text"),
    "pipelines/session/terminal_lines.py": ({"msgspec"}, "lines as JSON"),
    "pipelines/session/training.py": ({"msgspec"}, "requests, answers and exercises as octets"),
    "pipelines/mission/tmtc_messages.py": ({"msgspec"}, "requests and news as octets"),
    "pipelines/mission/mission.py": ({"msgspec"}, "what outlives the process"),
    "pipelines/session/mission_messages.py": ({"msgspec"}, "messages of topics as octets"),
    "pipelines/session/task_journal.py": ({"msgspec"}, "rows that outlive the process"),
    "pipelines/link/figures.py": ({"msgspec"}, "a gateway's parameters as octets"),
    "pipelines/session/access.py": ({"hmac"}, "compares tokens in constant time"),
    "pipelines/seats/command_desk.py": ({"msgspec"}, "texts as JSON"),
    "pipelines/seats/mission_desk.py": ({"msgspec"}, "texts as JSON"),
    "pipelines/seats/seat.py": ({"msgspec"}, "texts as JSON"),
    "pipelines/seats/figures.py": ({"msgspec"}, "texts as JSON"),
    "pipelines/media/key_picture_maker.py": ({"av"}, "codes one picture"),
    "pipelines/seats/texts.py": ({"msgspec"}, "texts as JSON"),
    "pipelines/recording/": (
        {"av", "google", "io", "mcap", "msgspec", "zstandard"},
        "protobuf, MCAP and H.264: octets only; requests as JSON",
    ),
    "pipelines/foxglove/": ({"msgspec", "tomllib"}, "messages as JSON, and the setup as a table"),
    "pipelines/report/": ({"msgspec", "rich"}, "the report as JSON and as text"),
    "pipelines/report/account.py": ({"html"}, "the report as a page"),
    "pipelines/report/html_page.py": ({"html"}, "pages as text"),
    "pipelines/report/trace.py": ({"zlib"}, "rows as text"),
    "pipelines/report/live.py": ({"sys"}, "the terminal"),
    "pipelines/report/model.py": ({"json"}, "the report as JSON"),
    "pipelines/partner/description.py": ({"aiortc"}, "session descriptions as text"),
    "pipelines/partner/ice_servers.py": ({"aiortc", "hmac"}, "credentials from a secret"),
    "pipelines/partner/tracks.py": ({"aiortc"}, "the estimate of a rate"),
    "pipelines/ros2/": ({"cv2", "msgspec", "rosbags"}, "CDR, JPEG and JSON: octets only"),
    "pipelines/study/effects.py": ({"html", "scipy"}, "distributions, and the effects as a page"),
    "pipelines/study/desk.py": ({"msgspec"}, "texts as JSON"),
    "pipelines/virtual/simulate.py": ({"msgspec"}, "copies a part of the report"),
    "pipelines/virtual/session.py": ({"msgspec"}, "copies a part of the report"),
}


def library(module: str) -> set[str]:
    """What `module` may import by LIBRARIES."""
    names: set[str] = set()
    for place, (libraries, _) in LIBRARIES.items():
        if module.startswith(place):
            names |= libraries
    return names


def is_command(module: str) -> bool:
    """Whether a module is the command of a bench, or says what a folder of them exports."""
    of_bench = module.startswith("pipelines/bench/")
    return of_bench and (module.count("/") == 2 or module.endswith(("/command.py", "/__init__.py")))


def is_shell(module: str) -> bool:
    return (
        module in SHELLS
        or module in FILES
        or module in USERS_OF_SHELLS
        or module.startswith(SHELL_FOLDERS)
        or PROCESS.fullmatch(module) is not None
        or is_command(module)
    )


def names_from_shells(module: str) -> set[str]:
    """What a module imports from shells, within functions too, but for `PURE_NAMES`."""
    found: set[str] = set()
    for node in imports_of(ROOT / module):
        if isinstance(node, ast.Import):
            pairs = [(alias.name, "") for alias in node.names]
        else:
            # `from package import module` imports a module, too.
            pairs = [(f"{node.module}.{alias.name}", "") for alias in node.names]
            pairs += [(node.module or "", alias.name) for alias in node.names]
        for package, name in pairs:
            file = package.replace(".", "/") + ".py"
            if is_shell(file) and name not in PURE_NAMES.get(file, ()):
                found.add(f"{package}.{name}")
    return found


def modules() -> list[str]:
    found = [path for package in ORDER for path in (ROOT / package).rglob("*.py")]
    return sorted(path.relative_to(ROOT).as_posix() for path in found)


def imported(module: str) -> set[str]:
    """Top-level names of all packages that a module imports, within functions too."""
    names: set[str] = set()
    for node in imports_of(ROOT / module):
        if isinstance(node, ast.Import):
            names |= {alias.name.partition(".")[0] for alias in node.names}
        else:
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


def test_nothing_imports_the_benchmarks():
    """They lie outside of the wheel; only their tests and the documents' generator may."""
    samples = [path.relative_to(ROOT).as_posix() for path in (ROOT / "samples").rglob("*.py")]
    assert [one for one in [*modules(), *samples] if "benchmarks" in imported(one)] == []


def rooms_of_pipelines(module: str) -> set[str]:
    """The rooms of `pipelines` that a module imports, within functions too."""
    names: set[str] = set()
    for node in imports_of(ROOT / module):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        else:
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    found = {tuple(name.split(".")[:2]) for name in names}
    return {room for package, *rest in found for room in rest if package == "pipelines"}


@pytest.mark.parametrize("tier", range(len(TIERS)), ids=lambda tier: "-".join(sorted(TIERS[tier])))
def test_imports_of_pipelines_run_one_way(tier):
    above = set().union(*TIERS[tier:])
    wrong = {
        module: found
        for module in modules()
        for room in TIERS[tier]
        if module.startswith(f"pipelines/{room}/")
        and (found := rooms_of_pipelines(module) & (above - {room}))
    }
    assert wrong == {}, "what two rooms need lies on the floor below both"


def test_every_room_of_pipelines_has_its_tier():
    rooms = {path.parent.name for path in (ROOT / "pipelines").glob("*/__init__.py")}
    assert rooms == set().union(*TIERS)
    in_the_root = {path.name for path in (ROOT / "pipelines").glob("*.py")}
    assert len(in_the_root) <= MOST_IN_THE_ROOT


def test_cores_import_only_what_is_allowed():
    wrong = {
        module: found
        for module in modules()
        if not is_shell(module) and (found := imported(module) - {*ORDER, *PURE, *library(module)})
    }
    assert not wrong, "a core is given the time and the octets; a new shell is named in SHELLS"


def test_cores_import_no_shell():
    wrong = {
        module: found
        for module in modules()
        # A package's __init__ only says what it exports.
        if not is_shell(module)
        and not module.endswith("/__init__.py")
        and (found := names_from_shells(module))
    }
    assert not wrong, "a core is handed what a shell has read"


def test_modules_that_use_no_shell_any_more_leave_the_list():
    unused = {
        module
        for module in USERS_OF_SHELLS
        if not names_from_shells(module) and not imported(module) - {*ORDER, *PURE}
    }
    assert unused == set()


def test_the_list_of_libraries_has_no_unused_entry():
    used = {place: set() for place in LIBRARIES}
    for module in modules():
        for place in LIBRARIES:
            if module.startswith(place):
                used[place] |= imported(module)
    assert {place for place, (names, _) in LIBRARIES.items() if not names <= used[place]} == set()


def test_the_list_of_shells_has_no_core():
    assert {module for module in SHELLS if not imported(module) & DOORS} == set()
