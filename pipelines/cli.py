"""The `kontur-av` command."""

import argparse
import errno
import gc
import os
import platform
import re
import signal
import sys
from collections.abc import Callable, Sequence
from functools import partial
from importlib import import_module
from types import FrameType
from typing import Any

from kontur_av import __version__
from kontur_av.errors import ConfigError
from pipelines.session.command_process import (
    discard_output,
    handled,
    hide_secrets,
    keep_words_apart,
    prepare_output,
    reader_gone,
)
from pipelines.session.setup.former_names import COMMANDS, current

WELL, FAILED, MISTAKE = 0, 1, 2
#: What the system can refuse to any program, and the fix.
_SYSTEM = {
    errno.ENOSPC: "free some room",
    errno.EDQUOT: "free some of your quota",
    errno.EROFS: "make the file system writable",
    errno.EMFILE: "raise `ulimit -n`",
    errno.ENFILE: "end other programs",
    errno.ENOMEM: "end other programs",
}
#: The exit code with which shells report the end by SIGINT (signal 2).
INTERRUPTED = 128 + 2


class CommandParser(argparse.ArgumentParser):
    """A parser that reports mistakes as ConfigError, in one line like all others.

    Values that may be left out can stand before, between and behind options. argparse itself takes
    none of them once an option has come: `run DIR --inbox FOLDER -- -q`.
    """

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        words = list(sys.argv[1:] if args is None else args)
        later = [one for one in self._get_positional_actions() if one.nargs in ("*", "?")]
        many = [one for one in later if one.nargs == "*"]
        if not later or ("--" in words and not many):
            return super().parse_known_args(words, namespace)
        at = words.index("--") if "--" in words else len(words)
        known = self._actions
        self._actions = [one for one in known if one not in later]
        try:
            found, rest = super().parse_known_args(words[:at], namespace)
        finally:
            self._actions = known
        odd = [one for one in rest if one[:1] == "-" and not self._is_value(one)]
        values = [one for one in rest if one not in odd] + words[at + 1 :]
        for one in later:
            count = len(values) if one.nargs == "*" else 1
            self._give(one, values[:count], found)
            del values[:count]
        return found, odd + values

    def _is_value(self, word: str) -> bool:
        return word == "-" or bool(self._negative_number_matcher.match(word))

    def _give(self, one: argparse.Action, values: list[str], found: argparse.Namespace) -> None:
        if not values and hasattr(found, one.dest) and getattr(found, one.dest) != one.default:
            return
        try:
            one(self, found, self._get_values(one, values))
        except argparse.ArgumentError as error:
            self.error(str(error))

    def error(self, message: str) -> None:  # type: ignore[override]
        # A value that begins with a dash is taken for an option.
        if message.endswith(": expected one argument"):
            option = message.split()[1].rstrip(":").split("/")[-1]
            message += f" (one that begins with - is given as {option}=VALUE)"
        elif "required: FILE" in message:
            message += " (a name that begins with - is given as ./NAME)"
        raise ConfigError(f"{message}; see `{self.prog} --help`")


#: Each is a module of `pipelines.commands`, or `pipelines.bench`: `add_arguments` and `run`.
_HELP = """run:
  stream     run a whole telepresence session on this machine
  link       run the radio link alone, for any programs
  simulate   run a session on virtual time: the same seed, the same report
  replay     send a recorded session through a link again
  sweep      run many sessions on virtual time: any fields, radios and seeds, one table
  send       send one stream as plain RTP, under a hard cap
  receive    receive one stream of plain RTP
  publish    send a picture and a voice to a media server, by WebRTC
  watch      receive a picture and a voice from a media server, by WebRTC
  rtc        serve a partner across the Internet, by WebRTC

operate:
  select     switch the camera of a running session
  tc         send a telecommand, and print its verification
  task       list, select, start and abort tasks of a running session
  stop       emergency stop of the robot, or its release
  authority  say who drives the robot, or hand it to a partner
  trainer    give a running session an exercise: no signal, a fault, a lost camera
  maintain   run a sequence of commands, each of which is confirmed
  file       put, get, list, rename and remove files at the other end of a running session
  robot      check the driver of your own robot
  joystick   list joysticks, check one, or drive a robot with one
  yamcs      write an instance of YAMCS that reads a session's telemetry and commands it

record:
  record     record a running session, and leave it again
  info       list what is in a recording, gaps and losses included
  recover    make a whole recording of a torn one
  export     make MATLAB tables, CSV, video files, or a data set for learning, of a recording
  report     show what a session gave, as a page too; join the reports of two ends
  archive    keep the reports of many sessions, and show how a figure went

measure:
  bench      measure this machine and this link: latency, sync, pictures, cost
  study      measure how stiffness, damping and inertia of a handle change what hands can do
  topology   list the processes, streams and topics of a session
  doctor     check what this machine can do
  devices    list cameras, microphones and scenes

upkeep:
  keys       make this machine's key, and say which machines it trusts
  versions   update the link's software, and fall back by itself from a version that fails
  apploader  run the joystick's software from the copy that works
"""
_COMMANDS = dict(re.findall(r"^  (\w+) +(.*)", _HELP, re.MULTILINE))


def make_parser(only: str | None = None) -> argparse.ArgumentParser:
    """The parser of all commands; with `only`, no other command's module is loaded."""
    parser = CommandParser(
        prog="kontur-av",
        description="Video, voice and force feedback through one thin radio link.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog=_HELP,
    )
    parser.add_argument("--version", action="version", version=f"kontur-av {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, text in _COMMANDS.items():
        # `stream` has a short help of its own.
        command = commands.add_parser(name, description=text, add_help=name != "stream")
        if only in (None, name):
            # Codecs take most of a second to load, for which `select` must not wait.
            room = "pipelines" if name == "bench" else "pipelines.commands"
            module = import_module(f"{room}.{name}")
            module.add_arguments(command)
            command.set_defaults(run=module.run)
    return parser


def _check_system(command: str) -> None:
    """Refuse a command on another system than Linux, before it imports what only Linux has."""
    system = platform.system()
    if system != "Linux" and command in _COMMANDS and command != "doctor":
        raise ConfigError(
            f"{system} is not supported: kontur-av needs Linux, also in a virtual machine, "
            "in WSL 2 or in a container"
        )


def _loaded(command: str, *, alone: bool) -> argparse.ArgumentParser:
    """The parser, with the module of the command. alone: the process is this command's."""
    if not alone:
        return make_parser(command)
    # Modules are no garbage. To look for it among them takes 0.1 s, most of it at the exit.
    gc.disable()
    try:
        return make_parser(command)
    finally:
        gc.freeze()
        gc.enable()


def _publish(line: str) -> None:
    """Print it on standard error in one line, whatever the names and values in it hold."""
    signs = (c if c.isprintable() else c.encode("unicode_escape").decode() for c in line)
    print("".join(signs), file=sys.stderr)


def exit_code(work: Callable[[], int], name: str) -> int:
    """What `work` returns; 2 with one line for the user's mistake, 130 if interrupted.

    name: of the program, at the beginning of that line.
    """
    # Before NumPy is loaded: its library's threads would not survive the launcher's forks.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    prepare_output()
    try:
        code = work()
        sys.stdout.flush()
        return code
    except ConfigError as error:
        _publish(f"{name}: {error}")
        return MISTAKE
    except OSError as error:
        if isinstance(error, BrokenPipeError) and reader_gone():
            discard_output()
            return WELL
        if error.errno == errno.ENAMETOOLONG:
            _publish(f"{name}: {error.filename!r}: {error.strerror}: shorten it")
            return MISTAKE
        fix = _SYSTEM.get(error.errno or 0)
        if fix is None:
            raise
        if not error.filename:
            discard_output()  # perhaps it was full
        at = f" {error.filename}:" if error.filename else ""
        _publish(f"{name}:{at} {error.strerror}: {fix}")
        return FAILED
    except KeyboardInterrupt:
        return INTERRUPTED


#: Commands that read recordings by mapping them into memory.
_READERS = {"info", "export", "recover"}


def _apart(work: Callable[[], int]) -> int:
    """Return what `work` returns in a child; its parent outlives SIGBUS.

    That signal comes when a file becomes shorter while it is read. Python cannot handle it. What
    ends the parent interrupts the child, which then removes what it has begun to write.
    """
    child = 0

    def end(_number: int, _frame: FrameType | None) -> None:
        if not child:
            raise KeyboardInterrupt
        os.kill(child, signal.SIGTERM)

    with handled(end):
        child = os.fork()
        if not child:
            # A terminal tells both; the child hears it from its parent, once.
            for number in (signal.SIGINT, signal.SIGHUP):
                signal.signal(number, signal.SIG_IGN)
            return work()
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if code == -signal.SIGBUS:
        print(
            "kontur-av: a file became shorter while it was read: begin again when its program "
            "has written it",
            file=sys.stderr,
        )
        return FAILED
    return code if code >= 0 else 128 - code


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; 0 well, 1 something failed, 2 the user's mistake, 130 interrupted."""

    def work() -> int:
        words = sys.argv[1:] if arguments is None else list(arguments)
        words[:1] = [current(word, COMMANDS) for word in words[:1]]
        _check_system(words[0] if words else "")
        parser = _loaded(words[0] if words else "", alone=arguments is None)
        args = parser.parse_args(words)
        keep_words_apart(args)
        result: int = args.run(args)
        return result

    if arguments is None:
        hide_secrets()
    apart = arguments is None and _READERS.intersection(sys.argv[1:2])
    return exit_code(partial(_apart, work) if apart else work, "kontur-av")


if __name__ == "__main__":
    sys.exit(main())
