"""What may import what: the three packages in one direction, and no clock or socket in a core."""

import ast
import re
from collections.abc import Iterator
from functools import cache

import pytest
from positions import ROOT, imports_of


def words(*lines: str) -> set[str]:
    return {word for line in lines for word in line.split()}


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
#: Every module of this name is the shell of a process; those in these folders are commands.
PROCESS = re.compile(r"pipelines/(?!report/)\w+/process_\w+\.py")
SHELL_FOLDERS = ("pipelines/commands/",)

#: The other shells: they open a door, read files, or use a module that does. All others are cores.
SHELLS = {
    "kontur_av": "clock hosts",
    "kontur_av/sources": (
        "camera file live looped microphone network pipe recording scene source spec user v4l2"
    ),
    "kontur_av/streams": (
        "async_closing decoding encoding_thread feeds loudspeaker senders sending stream_receiver "
        "udp"
    ),
    "kontur_av/topics": "bus file_node iceoryx_node notifier session_files",
    "pipelines": "cli",
    "pipelines/bench": "latency link session sync",
    "pipelines/bench/course": "ends",
    "pipelines/bench/video": "clips command contenders",
    "pipelines/commands": "live_session",
    "pipelines/files": "process_files service_sockets",
    "pipelines/hand": (
        "device_check driver_checks haptic_loop partner_arm process_ends safety_ends timed_calls"
    ),
    "pipelines/link": "key_files own_ends process_gateway relay",
    "pipelines/media": (
        "coded_topics input_devices key_picture_maker process_receive process_send sending"
    ),
    "pipelines/mission": "driving joined_session process_tasks process_tmtc tmtc_socket",
    "pipelines/partner": "coded_sources peer samples server transport whip",
    "pipelines/recording": (
        "camera_reader live_output matroska part_files raw_pictures received_media recorded_parts "
        "recording_file replay_setup topic_samples"
    ),
    "pipelines/recording/export": "films lerobot table_files",
    "pipelines/report": "charts live process_metrics report_file schema session_feed",
    "pipelines/seats": "process_page seat_sockets seat_topics upkeep_watch",
    "pipelines/session": (
        "command_process datagrams kept_files launcher machine_checks option_rows options "
        "page_sockets process recording_requests requests served_pages serving_loop sessions "
        "site_file topic_ends web_site"
    ),
    "pipelines/session/setup": "former_names setup_file sources",
    "pipelines/study": "running",
    "pipelines/upkeep": "archive loader_keeper requests sequence_runner version_keeper",
    "pipelines/virtual": "media mission session simulate streams studio workers",
    "pipelines/virtual/campaign": "sessions sweep sweep_file",
    "telepresence": "private_file toml_file",
    "telepresence/haptics": "specs udp_devices udp_line",
    "telepresence/haptics/device": "gamepad",
    "telepresence/link/radio": "profile_file",
    "telepresence/tasks": "task_files",
    "telepresence/tmtc/pus": "dictionary_file",
    "telepresence/world": "scenes",
}

#: What a core may import from a shell: constants, types, and conversions that ask nothing.
PURE_NAMES = {
    "kontur_av/sources/source.py": {"FILLED_BY_OTHERS", "PAGE", "TOPIC"},
    "pipelines/session/recording_requests.py": {"PartLimits", "RecordingOptions", "StartRecording"},
    "pipelines/session/setup/former_names.py": {"INPUTS"},
    "telepresence/haptics/specs.py": {"PAGE", "ROS2_HAND", "SIMULATED", "is_simulated"},
    "kontur_av/clock.py": words("NS_PER_MS NS_PER_S NS_PER_US ntp_from_unix_ns unix_ns_from_ntp"),
}

#: Modules that a core may import: they compute, and do no I/O.
PURE = words(
    "__future__ array base64 binascii bisect collections contextlib copy dataclasses difflib enum",
    "fractions functools hashlib heapq hmac html importlib io ipaddress itertools json math",
    "msgspec numpy operator queue random re shlex statistics string struct textwrap tomllib types",
    "typing weakref zlib",
)

#: Further libraries, and the cores or rooms that may import them.
LIBRARIES = {
    "OpenSSL": "telepresence/link/protection/agreement.py",
    "aiortc": (
        "pipelines/partner/description.py pipelines/partner/ice_servers.py "
        "pipelines/partner/tracks.py"
    ),
    "ast": "kontur_av/lazy.py",
    "av": (
        "kontur_av/codecs/ kontur_av/sources/file.py kontur_av/sources/fit.py "
        "kontur_av/sources/looped.py pipelines/media/key_picture_maker.py pipelines/recording/ "
        "telepresence/world/scenes.py"
    ),
    "cbor2": "telepresence/tmtc/k2aci.py",
    "cryptography": "telepresence/link/protection/ telepresence/upkeep/manifest.py",
    "ctypes": (
        "kontur_av/codecs/libopus.py kontur_av/codecs/x264.py kontur_av/topics/bus.py "
        "kontur_av/topics/iceoryx_node.py"
    ),
    "cv2": (
        "kontur_av/codecs/ kontur_av/detect.py kontur_av/sources/stereo.py "
        "pipelines/bench/video/quality.py pipelines/media/marking.py pipelines/ros2/ "
        "telepresence/world/"
    ),
    "datetime": "telepresence/link/protection/identity.py telepresence/link/radio/orbit.py",
    "google": "kontur_av/sources/recording.py pipelines/recording/",
    "iceoryx2": "kontur_av/topics/iceoryx_node.py",
    "inspect": "kontur_av/parts.py",
    "lz4": "kontur_av/sources/recorded_format.py",
    "mcap": "kontur_av/sources/recording.py pipelines/recording/",
    "pathlib": (
        "kontur_av/codecs/carried.py kontur_av/parts.py kontur_av/sources/file.py "
        "kontur_av/sources/recording.py pipelines/report/result.py "
        "pipelines/session/setup/setup_file.py telepresence/link/radio/profile_file.py "
        "telepresence/tasks/task_files.py telepresence/tmtc/pus/dictionary_file.py "
        "telepresence/toml_file.py telepresence/world/scenes.py"
    ),
    "pickle": "pipelines/session/probe.py",
    "prometheus_client": "pipelines/report/exposition.py",
    "rich": "pipelines/report/",
    "rosbags": "pipelines/ros2/",
    "scipy": "pipelines/study/effects.py",
    "sgp4": "telepresence/link/radio/orbit.py",
    "spacepackets": "telepresence/files/pdus.py telepresence/tmtc/pus/packets.py",
    "struct": "kontur_av/sources/recording.py",
    "sys": ("kontur_av/codecs/libopus.py kontur_av/lazy.py kontur_av/parts.py"),
    "tarfile": "telepresence/upkeep/inbox.py",
    "threading": "kontur_av/codecs/colours.py",
    "warnings": "kontur_av/codecs/libopus.py kontur_av/lazy.py",
    "xml": (
        "telepresence/tasks/reader.py telepresence/tmtc/pus/xtce telepresence/tmtc/routes.py "
        "telepresence/xml_file.py"
    ),
    "zstandard": "kontur_av/sources/recorded_format.py pipelines/recording/",
}


def library(module: str) -> set[str]:
    """What `module` may import by LIBRARIES."""
    return {name for name, places in LIBRARIES.items() if module.startswith(tuple(places.split()))}


def is_command(module: str) -> bool:
    """Whether a module is the command of a bench, or says what a folder of them exports."""
    of_bench = module.startswith("pipelines/bench/")
    return of_bench and (module.count("/") == 2 or module.endswith(("/command.py", "/__init__.py")))


def is_shell(module: str) -> bool:
    room, _, name = module.removesuffix(".py").rpartition("/")
    return (
        name in SHELLS.get(room, "").split()
        or module.startswith(SHELL_FOLDERS)
        or PROCESS.fullmatch(module) is not None
        or is_command(module)
    )


def names_from_shells(module: str) -> set[str]:
    """What a module imports from shells, within functions too, but for `PURE_NAMES`."""
    found: set[str] = set()
    for package, name in imports(module):
        # `from package import module` imports a module, too.
        for place, what in ((package, name), (f"{package}.{name}", "")):
            file = place.replace(".", "/") + ".py"
            if is_shell(file) and what not in PURE_NAMES.get(file, ()):
                found.add(f"{place}.{what}")
    return found


@cache
def modules() -> list[str]:
    found = [path for package in ORDER for path in (ROOT / package).rglob("*.py")]
    return sorted(path.relative_to(ROOT).as_posix() for path in found)


def imports(module: str) -> Iterator[tuple[str, str]]:
    """(module, name or "") of each import, within functions too."""
    for node in imports_of(ROOT / module):
        for alias in node.names:
            if isinstance(node, ast.Import):
                yield alias.name, ""
            else:
                # A relative import would hide where it leads.
                yield node.module or "." if not node.level else ".", alias.name


@cache
def imported(module: str) -> set[str]:
    """Top-level names of all packages that a module imports."""
    return {name.partition(".")[0] or "." for name, _ in imports(module)}


@pytest.mark.rule("1")
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
    found = (f"{package}.{name}".split(".") for package, name in imports(module))
    return {room for package, room, *_ in found if package == "pipelines"}


@pytest.mark.rule("1")
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


@pytest.mark.rule("2")
def test_cores_import_only_what_is_allowed():
    wrong = {
        module: found
        for module in modules()
        if not is_shell(module) and (found := imported(module) - {*ORDER, *PURE, *library(module)})
    }
    assert not wrong, "a core is given the time and the octets; a new shell is named in SHELLS"


@pytest.mark.rule("2")
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


@cache
def cores_imported(module: str) -> set[str]:
    """The cores that a module imports and that are driven with `now_ns`."""
    names = {one for package, name in imports(module) for one in (package, f"{package}.{name}")}
    files = {name.replace(".", "/") + ".py" for name in names} & {*modules()}
    return {
        file
        for file in files
        if not is_shell(file) and "now_ns" in (ROOT / file).read_text(encoding="utf-8")
    }


@pytest.mark.rule("3")
def test_every_process_shares_a_core_with_the_simulation():
    simulated = set().union(*map(cores_imported, (ROOT / "pipelines").glob("virtual/*.py")))
    while more := set().union(*map(cores_imported, simulated)) - simulated:
        simulated |= more
    processes = [module for module in modules() if PROCESS.fullmatch(module)]
    assert [process for process in processes if not cores_imported(process) & simulated] == []


def test_the_lists_have_no_unused_entry():
    shells = {f"{room}/{name}.py" for room, names in SHELLS.items() for name in names.split()}
    opened = {shell for shell in shells & {*modules()} if imported(shell) - {*ORDER, *PURE}}
    assert {shell for shell in shells - opened if not names_from_shells(shell)} == set()
    for name, places in LIBRARIES.items():
        for place in places.split():
            assert any(name in imported(one) for one in modules() if one.startswith(place)), place
