"""Signals, threads and memory of the whole process are set by named functions of shells only.

A constructor or an import that sets them would surprise the program that uses the packages.
"""

import ast
from collections.abc import Iterator
from functools import cache

from positions import ROOT, tree_of

PACKAGES = ("kontur_av", "telepresence", "pipelines")

#: Calls that change the whole process, by the end of their dotted names.
SETTERS = {
    name
    for line in (
        "catch_warnings chdir gc.collect gc.disable gc.enable gc.freeze gc.set_threshold",
        "gc.unfreeze mallopt mlockall nice np.random.seed np.seterr os.putenv os.umask prctl",
        "pthread_sigmask random.seed sched_setaffinity sched_setscheduler set_start_method",
        "set_wakeup_fd setNumThreads setUseOptimized setdefaulttimeout setitimer setlocale",
        "setpriority setprofile setrecursionlimit setrlimit setswitchinterval settrace",
        "signal.signal simplefilter stack_size",
    )
    for name in line.split()
}

#: Who may call them: a command, the launcher, and what runs first in a process of its own.
ALLOWED = {
    # For the time of an import whose warnings are not ours.
    "kontur_av/codecs/libopus.py": {"_import_with"},
    "kontur_av/streams/encoding_thread.py": {"switch_threads_often"},
    # `end_with_parent`: in a new process, before it begins.
    "pipelines/session/command_process.py": {"handled", "end_with_parent"},
    # For the time of one call of a user's driver, in a command of its own.
    "pipelines/hand/timed_calls.py": {"TimedCalls._timed.call"},
    "pipelines/session/machine_checks.py": {"take_descriptors"},
    # For the time of a connection, whose warnings are told in one line of ours.
    "pipelines/virtual/campaign/sessions.py": {"_connected"},
    "pipelines/bench/video/command.py": {"run"},
    "pipelines/bench/course/ends.py": {"_become"},
    # The command itself, in a process of its own.
    "pipelines/cli.py": {"_loaded", "_apart"},
    "pipelines/partner/whip.py": {"_relay"},
    "pipelines/recording/live_output.py": {"_write"},
    "pipelines/virtual/simulate.py": {"_run"},
    "pipelines/session/launcher.py": {"load_libraries", "keep_memory"}
    | {f"Launcher.{name}" for name in ("run", "_start", "_become_child")},
    "pipelines/session/process.py": {
        "become",
        "take_realtime",
        "_judge_share",
        "Collections.handle_flush",
    },
    "pipelines/virtual/workers.py": {"Worker.start", "_work"},
}
#: Functions among them that others call by these names.
CALLED = {"switch_threads_often", "load_libraries", "keep_memory", "become", "end_with_parent"}
CALLED |= {"stopped_by_signals", "take_realtime"}
CONSTRUCTORS = {"__init__", "__new__", "__post_init__"}


def calls(node: ast.AST, place: str = "") -> Iterator[tuple[str, str]]:
    """(function in which it stands, dotted name) of every call; "" outside of functions."""
    for child in ast.iter_child_nodes(node):
        inner = place
        if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            inner = f"{place}.{child.name}" if place else child.name
        elif isinstance(child, ast.Call):
            yield place, dotted(child.func)
        yield from calls(child, inner)


def dotted(node: ast.AST) -> str:
    """The dotted name. Parts that are not names are left empty."""
    if isinstance(node, ast.Attribute):
        return f"{dotted(node.value)}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else ""


def found(names: set[str]) -> dict[str, set[str]]:
    """By module: the functions that call one of these."""
    result: dict[str, set[str]] = {}
    ends = tuple(f".{setter}" for setter in names)
    for module, place, name in all_calls():
        if f".{name}".endswith(ends):
            result.setdefault(module, set()).add(place)
    return result


@cache
def all_calls() -> list[tuple[str, str, str]]:
    """(module, function in which it stands, dotted name) of every call."""
    return [
        (path.relative_to(ROOT).as_posix(), place, name)
        for package in PACKAGES
        for path in sorted((ROOT / package).rglob("*.py"))
        for place, name in calls(tree_of(path))
    ]


def test_only_named_functions_set_what_belongs_to_the_process():
    assert found(SETTERS) == ALLOWED


def test_no_constructor_and_no_import_sets_what_belongs_to_the_process():
    places = [*found(SETTERS).values(), *found(CALLED).values()]
    # A class's body runs at its import; a method's name has a dot, a class's begins with a capital.
    wrong = {
        place
        for each in places
        for place in each
        if not place
        or (place[0].isupper() and "." not in place)
        or CONSTRUCTORS & {*place.split(".")}
    }
    assert not wrong
