"""A UDP relay between two hosts: it delays, drops, repeats and reorders datagrams, and attacks.

As a program: `path_relay.py --listen HOST:PORT --to HOST:PORT [--delay-ms …] …`. What comes from
`--to` goes to the address that sent last. Orders come as lines on standard input, each answered by
a line of JSON:

    attack KIND COUNT   with each of the next COUNT datagrams of each way, send one more of KIND:
                        flip (a copy with one bit changed), truncate, extend, replay (one that was
                        relayed before), earlier (one relayed before the last `mark`), inject
                        (random octets with the first four of a genuine one)
    mark                what was relayed so far belongs to an earlier session
    figures             datagrams relayed, and sent as attacks, by receiving end and kind

`Relay` starts it from a test.
"""

import argparse
import heapq
import json
import random
import selectors
import socket
import subprocess
import sys
import time
from collections import Counter, deque

#: What an attacker remembers of each way.
_REMEMBERED = 20_000
KINDS = ("flip", "truncate", "extend", "replay", "earlier", "inject")


class Attacker:
    """Makes datagrams that an end must drop, from those of one way."""

    def __init__(self, draw):
        self._draw = draw
        self._seen = deque(maxlen=_REMEMBERED)
        self._earlier = []
        self.left = Counter()
        self.sent = Counter()

    def mark(self):
        self._earlier = list(self._seen)
        self._seen.clear()

    def datagrams(self, genuine):
        """Return what to send beside this genuine one."""
        made = []
        for kind in KINDS:
            if self.left[kind] <= 0:
                continue
            octets = self._make(kind, genuine)
            if octets is None:
                continue
            self.left[kind] -= 1
            self.sent[kind] += 1
            made.append(octets)
        self._seen.append(genuine)
        return made

    def _make(self, kind, genuine):
        draw = self._draw
        if kind == "flip":
            bit = draw.randrange(8 * len(genuine))
            octets = bytearray(genuine)
            octets[bit // 8] ^= 1 << bit % 8
            return bytes(octets)
        if kind == "truncate":
            return genuine[: draw.randrange(len(genuine))]
        if kind == "extend":
            return genuine + draw.randbytes(draw.randrange(1, 40))
        if kind == "inject":
            return genuine[:4] + draw.randbytes(len(genuine) - 4)
        known = self._seen if kind == "replay" else self._earlier
        return draw.choice(known) if known else None


def serve(listen, to, *, delay_ms, jitter_ms, loss, repeat, seed):
    draw = random.Random(seed)
    near = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    far = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    near.bind(listen)
    far.bind((listen[0], 0))
    selector = selectors.DefaultSelector()
    for one in (near, far, sys.stdin):
        selector.register(one, selectors.EVENT_READ)
    ways = {near: Attacker(draw), far: Attacker(draw)}
    relayed, waiting, number, caller = Counter(), [], 0, None
    while True:
        wait_s = max(0.0, waiting[0][0] - time.monotonic()) if waiting else None
        for key, _ in selector.select(wait_s):
            if key.fileobj is sys.stdin:
                line = sys.stdin.readline()
                if not line:
                    return
                print(_obey(line.split(), ways, near, relayed), flush=True)
                continue
            udp = key.fileobj
            try:
                octets, source = udp.recvfrom(65_535)
            except OSError:
                continue  # an ICMP error of an earlier datagram
            if udp is near:
                caller = source
            elif source != to:
                continue
            attacks = ways[udp].datagrams(octets)
            genuine = [octets] * (draw.random() >= loss) + [octets] * (draw.random() < repeat)
            relayed[udp is near] += len(genuine)
            for each in (*genuine, *attacks):
                late_s = (delay_ms + draw.random() * jitter_ms) / 1000
                number += 1
                heapq.heappush(waiting, (time.monotonic() + late_s, number, udp is near, each))
        while waiting and waiting[0][0] <= time.monotonic():
            _, _, outward, octets = heapq.heappop(waiting)
            try:
                if outward:
                    far.sendto(octets, to)
                elif caller is not None:
                    near.sendto(octets, caller)
            except OSError:
                pass  # no route while a cable is out


def _obey(words, ways, near, relayed):
    match words:
        case ["attack", kind, count]:
            for attacker in ways.values():
                attacker.left[kind] = int(count)
        case ["mark"]:
            for attacker in ways.values():
                attacker.mark()
    names = {True: "to_far", False: "to_near"}
    return json.dumps(
        {
            names[udp is near]: {"relayed": relayed[udp is near], **attacker.sent}
            for udp, attacker in ways.items()
        }
    )


class Relay:
    """The program in a host of `TwoHosts`, from `with` to its end."""

    def __init__(self, prefix, listen, to, **options):
        words = [f"--{name.replace('_', '-')}={value}" for name, value in options.items()]
        command = (*prefix, sys.executable, __file__, "--listen", listen, "--to", to, *words)
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._process.stdin.close()
        self._process.wait()
        self._process.stdout.close()

    def order(self, *words):
        """Give an order; return the figures."""
        print(*words, file=self._process.stdin, flush=True)
        return json.loads(self._process.stdout.readline())


def _address(text):
    host, _, port = text.rpartition(":")
    return host, int(port)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--listen", type=_address, required=True)
    parser.add_argument("--to", type=_address, required=True)
    for option in ("delay-ms", "jitter-ms", "loss", "repeat"):
        parser.add_argument(f"--{option}", type=float, default=0.0)
    parser.add_argument("--seed", type=int, default=1)
    args = vars(parser.parse_args())
    serve(args.pop("listen"), args.pop("to"), **args)
