"""Two ends of PUS for tests: a small dictionary, an application, and its user."""

from collections.abc import Sequence
from typing import Any

from hypothesis import strategies as st

from telepresence.tmtc.pus.application import PusApplication
from telepresence.tmtc.pus.dictionary import Dictionary
from telepresence.tmtc.pus.dictionary_file import dictionary_from_table
from telepresence.tmtc.pus.node import PusNode
from telepresence.tmtc.pus.packets import Telecommand, Telemetry, parse_packet
from telepresence.tmtc.pus.user import PusUser

MS = 1_000_000
S = 1_000 * MS
#: By packet: when each of its copies arrives, in steps; none: it is lost.
FATES = st.lists(st.lists(st.integers(1, 12), max_size=2), max_size=40)


def sent(core: Any, now_ns: int = 0) -> list[bytes]:
    """All packets that `core` has to send now."""
    return list(iter(lambda: core.poll_transmit(now_ns), None))


def packets(core: Any, now_ns: int = 0) -> list[Any]:
    """The same, parsed."""
    return [parse_packet(octets) for octets in sent(core, now_ns)]


def events(core: Any) -> list[Any]:
    """All events of `core` that were not fetched yet."""
    return list(iter(core.next_event, None))


def command(
    service: int = 17, subtype: int = 1, data: bytes = b"", count: int = 1, **fields: int
) -> Telecommand:
    """A telecommand to the oven from source 7."""
    known: dict[str, Any] = {"apid": 0x200, "source": 7} | fields
    return Telecommand(count=count, service=service, subtype=subtype, data=data, **known)


def report(
    service: int, subtype: int, data: bytes = b"", count: int = 0, **fields: int
) -> Telemetry:
    """A report of the oven."""
    known: dict[str, Any] = {"apid": 0x200} | fields
    return Telemetry(count=count, service=service, subtype=subtype, data=data, **known)


class LossyPath:
    """Loses, repeats and reorders the first packets; later ones arrive at the next step."""

    def __init__(self, fates: Sequence[Sequence[int]]) -> None:
        self.fates = list(fates)
        self.flying: list[tuple[int, bytes]] = []

    def put(self, octets: bytes, step: int) -> None:
        for steps in self.fates.pop(0) if self.fates else [1]:
            self.flying.append((step + steps, octets))

    def arrivals(self, step: int) -> list[bytes]:
        due = [octets for at, octets in self.flying if at <= step]
        self.flying = [one for one in self.flying if one[0] > step]
        return due


def oven_table() -> dict[str, Any]:
    """What the TOML file of a small dictionary holds, anew for each call."""
    return {
        "oven": {
            "apid": 0x200,
            "parameter": {
                "temperature": {"number": 1, "type": "f32", "unit": "degC", "high": 200.0},
                "door": {"number": 2, "type": "choice", "choices": ["open", "closed"]},
                "target": {"number": 3, "type": "u16", "scale": 0.5, "writable": True, "high": 250},
                "lit": {"number": 4, "type": "bool"},
                "depth": {"number": 5, "type": "i32"},
            },
            "structure": {
                "state": {"number": 1, "parameters": ["temperature", "door"], "interval_s": 1.0},
                "light": {"number": 2, "parameters": ["lit"], "on": False},
            },
            "event": {
                "too_hot": {"number": 1, "severity": "high", "arguments": ["temperature"]},
                "cooled": {"number": 2, "severity": "info"},
            },
            "function": {
                "heat": {"number": 1, "arguments": ["target"]},
                "off": {"number": 2},
            },
            "monitor": {
                "heat": {
                    "number": 1,
                    "parameter": "temperature",
                    "high": 220.0,
                    "high_clear": 180.0,
                    "above": "too_hot",
                    "back": "cooled",
                    "repeat": 2,
                }
            },
            "action": [{"event": "too_hot", "function": "off"}],
        }
    }


def oven() -> Dictionary:
    """The small dictionary."""
    return dictionary_from_table(oven_table())


class Ends:
    """An oven in space, its user on the ground, and the flow between them.

    up, down: whether packets arrive. Time goes on with `run`.
    """

    def __init__(self, *, rate_bps: int = 1_000_000, first_count: int = 100) -> None:
        dictionary = oven()
        self.oven = PusApplication(dictionary.application("oven"), now_ns=0)
        self.user = PusUser(dictionary, source=7, first_count=first_count)
        self.space = PusNode(applications=[self.oven], rate_bps=rate_bps)
        self.ground = PusNode(user=self.user, rate_bps=rate_bps)
        self.up = self.down = True
        self.now_ns = 0
        self.telemetry: list[bytes] = []
        self.calls: list[tuple[str, tuple[Any, ...]]] = []
        self.refusal = ""

    def step(self) -> None:
        """Exchange what there is now, and carry out what is asked for."""
        for _ in range(3):
            while (octets := self.ground.poll_transmit(self.now_ns)) is not None:
                if self.up:
                    self.space.handle_packet(octets, self.now_ns)
            while (event := self.oven.next_event()) is not None:
                self.calls.append((type(event).__name__, tuple(event)[-3:][:2]))
                if hasattr(event, "token"):
                    self.oven.handle_result(event.token, self.refusal, self.now_ns)
            while (octets := self.space.poll_transmit(self.now_ns)) is not None:
                self.telemetry.append(octets)
                if self.down:
                    self.ground.handle_packet(octets, self.now_ns)

    def run(self, until_ns: int) -> None:
        """Go on until `until_ns`, from one timeout to the next."""
        while True:
            self.step()
            due = [end.poll_timeout(self.now_ns) for end in (self.space, self.ground)]
            next_ns = min((one for one in due if one is not None), default=until_ns)
            if next_ns >= until_ns:
                self.now_ns = until_ns
                self.step()
                return
            self.now_ns = max(next_ns, self.now_ns + 1)

    def events(self, *kinds: type) -> list[Any]:
        """What the user has to say, or only events of `kinds`."""
        return [event for event in events(self.user) if not kinds or isinstance(event, kinds)]
