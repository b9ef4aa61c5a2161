"""Octets for fuzzing: seeds of K2ACI, and a mutation that knows heads of CBOR items."""

from random import Random

from telepresence.tmtc.k2aci import (
    Acknowledgement,
    Chat,
    ChatRole,
    Numbered,
    PanelMode,
    PanelState,
    StartTask,
    TaskFinished,
    TaskGoal,
    TaskProgress,
    TaskResult,
    TaskSelected,
    pack_body,
)

K2ACI_BODIES = [
    pack_body(Numbered(258, 7, 5, TaskSelected(task="aiming", run=3, start_um=(-1, 9), text="go"))),
    pack_body(Numbered(1, 70_000, 0, StartTask(task="aiming", run=3))),
    pack_body(Numbered(1, 0, 0, TaskFinished(task="a", run=1, result=TaskResult.ABORTED))),
    pack_body(Numbered(1, 1, 0, TaskProgress(run=1, goal=TaskGoal.EIGHT, turn_ms=9000))),
    pack_body(Numbered(1, 3, 3, PanelState(mode=PanelMode.PRESS_DEADMAN, task="a", run=2))),
    pack_body(Numbered(1, 3, 3, Chat(sender=ChatRole.COSMONAUT, text="grüß Gott"))),
    pack_body(Acknowledgement(1 << 20, 4)),
    bytes.fromhex("c1fb41d452d9e20000008201d81c80d81d00"),
]
#: Heads of CBOR items: lengths, tags, floating point, indefinite arrays.
HEADS = bytes.fromhex(
    "00 17 18 19 1a 1b 20 3b 40 5b 5f 60 7b 80 84 9b 9f a0 bf c0 c2 d8 db f4 fb ff"
)


def mutate(random: Random, octets: bytes) -> bytes:
    """Change, insert, drop or repeat a few octets."""
    data = bytearray(octets)
    for _ in range(random.randint(1, 4)):
        at = random.randrange(len(data) + 1)
        way = random.randrange(5)
        value = random.choice(HEADS) if random.random() < 0.5 else random.randrange(256)
        if way == 0:
            data[at : at + 1] = bytes([value])
        elif way == 1:
            data[at:at] = bytes([value])
        elif way == 2:
            del data[at : at + random.randint(1, 4)]
        elif way == 3:
            data[at:at] = data[random.randrange(len(data) + 1) :][:8]
        elif at < len(data):
            data[at] ^= 1 << random.randrange(8)
    return bytes(data)
