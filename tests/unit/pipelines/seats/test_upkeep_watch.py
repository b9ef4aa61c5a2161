"""What the systems operator is shown of files on their way, and of the software of both ends."""

import os

import msgspec

from kontur_av.clock import NS_PER_MS, NS_PER_S
from pipelines.files.file_requests import FileRequests
from pipelines.seats.upkeep_watch import Transfers, software_in
from pipelines.session.requests import MAX_MESSAGE_OCTETS
from pipelines.session.setup.segments import Segment
from pipelines.session.transfer_requests import STATUS, FileRequest
from telepresence.files.entity import FileEntity, Transfer
from telepresence.upkeep.inbox import TOLD, UpdateInbox

GROUND = Segment.GROUND


def test_the_list_of_files_is_that_of_the_file_transfer():
    entity = FileEntity(entity=1, peer=2, first_number=7, rate_bps=64_000, now_ns=0)
    service, transfers = FileRequests(entity), Transfers()

    def answered(now_ns):
        return service.handle_request(FileRequest(file=STATUS), b"", "", now_ns)

    def status(now_ns):
        return transfers.handle_list(GROUND, answered(now_ns).transfers, now_ns)

    assert status(0) == []
    entity.put("a name.bin", "", bytes(40_000), 0)
    entity.ask("get", "log", "", 0)
    (put, get) = status(0)
    assert (put.end, put.number, put.what, put.name) == ("ground", 7, "put", "a name.bin")
    assert (put.state, put.octets, put.size, put.rate_bps) == ("suspended", 0, 40_000, 0)
    assert (get.what, get.name, get.size) == ("get", "log", None)
    for ms in range(2000):
        now_ns = ms * NS_PER_MS
        entity.handle_link(heard=True, waiting_octets=0, now_ns=now_ns)
        while entity.poll_transmit(now_ns) is not None:
            pass
        if ms == 1000:
            status(now_ns)
    put = status(2 * NS_PER_S)[0]
    assert put.state == "running"
    assert 0 < put.octets < put.size
    assert 50_000 < put.rate_bps < 70_000
    # A list of many files fits into one answer.
    entity.transfers.clear()
    for number in range(1 << 31, (1 << 31) + 40):
        transfer = Transfer(number=number, kind="rename", first="x" * 200, second="")
        entity.transfers[number] = transfer
    answer = answered(2 * NS_PER_S)
    assert len(answer.transfers) + answer.more == 40
    assert len(msgspec.msgpack.encode(answer)) < MAX_MESSAGE_OCTETS


def test_what_keepers_told_is_shown_with_where_it_is_from(tmp_path):
    inbox = UpdateInbox(("copy",))
    inbox.handle_done("new.tar", "written to sd/1", "")
    told = inbox.told("sd/1", "run", {"sd/1": "valid"})
    garbage = {"x": b"{", "y": b'{"runs": "\xff"}', "z": b'{"more": ' + b"[" * 60_000}
    for name, octets in {"joystick": told, **garbage}.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / TOLD).write_bytes(octets)
    (tmp_path / "link").mkdir()
    (tmp_path / "link" / TOLD).symlink_to(tmp_path / "joystick" / TOLD)
    (tmp_path / "way").symlink_to(tmp_path / "joystick")
    (tmp_path / "pipe").mkdir()
    os.mkfifo(tmp_path / "pipe" / TOLD)
    (found,) = software_in(tmp_path, "space")
    assert (found.end, found.inbox, found.runs, found.why) == ("space", "joystick", "sd/1", "run")
    assert found.states == {"sd/1": "valid"}
    assert found.answers == ("new.tar: taken, written to sd/1",)
    assert list(software_in(tmp_path / "none", "space")) == []
