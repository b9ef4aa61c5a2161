"""Files to and from cfdp-py, a CFDP implementation of others, over a link that loses PDUs.

It reads the wall clock by `spacepackets.countdown`, which is put on virtual time here.
"""

from contextlib import suppress
from pathlib import Path
from random import Random
from types import SimpleNamespace

import pytest
from common import first_seed, repeats
from file_pair import GROUND, SPACE, FileEnd

from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.files.entity import DONE

cfdppy = pytest.importorskip("cfdppy", reason="cfdp-py: pip install 'kontur-av[full]'")
pytestmark = pytest.mark.filterwarnings("ignore:base is deprecated")

from cfdppy.exceptions import (  # noqa: E402
    NoRemoteEntityConfigFound,
    PduIgnoredForDest,
    PduIgnoredForSource,
)
from cfdppy.filestore import NativeFilestore  # noqa: E402
from cfdppy.handler import DestHandler, SourceHandler  # noqa: E402
from cfdppy.handler.common import PacketDestination, get_packet_destination  # noqa: E402
from cfdppy.mib import (  # noqa: E402
    CheckTimerProvider,
    DefaultFaultHandlerBase,
    IndicationConfig,
    LocalEntityConfig,
    RemoteEntityConfig,
    RemoteEntityConfigTable,
)
from cfdppy.request import PutRequest  # noqa: E402
from cfdppy.user import CfdpUserBase  # noqa: E402
from spacepackets import countdown  # noqa: E402
from spacepackets.cfdp import ChecksumType, ConditionCode, PduFactory, TransmissionMode  # noqa: E402
from spacepackets.cfdp.pdu import EofPdu  # noqa: E402
from spacepackets.countdown import Countdown  # noqa: E402
from spacepackets.seqcount import SeqCountProvider  # noqa: E402
from spacepackets.util import ByteFieldU16  # noqa: E402

OCTETS = Random(1).randbytes(30_000)
STEP_NS = 20 * NS_PER_MS
LOSSES = [(0, 0.0), *((first_seed() + number, 0.1) for number in range(repeats(2)))]


class User(CfdpUserBase):
    """Its user: keeps how a transaction has ended."""

    def __init__(self) -> None:
        super().__init__(NativeFilestore())
        self.finished = []

    def transaction_finished_indication(self, params):
        self.finished.append(params.finished_params)

    def _nothing(self, *_args, **_named):
        """All else it may tell."""

    transaction_indication = eof_sent_indication = metadata_recv_indication = _nothing
    file_segment_recv_indication = report_indication = suspended_indication = _nothing
    resumed_indication = fault_indication = abandoned_indication = eof_recv_indication = _nothing


class Faults(DefaultFaultHandlerBase):
    def _nothing(self, *_args):
        """The end of the transaction tells."""

    notice_of_suspension_cb = notice_of_cancellation_cb = abandoned_cb = ignore_cb = _nothing


class Timers(CheckTimerProvider):
    def provide_check_timer(self, local_entity_id, remote_entity_id, entity_type):
        return Countdown.from_seconds(3)


class Peer:
    """cfdp-py as the other end, with ids of two octets."""

    def __init__(self, directory: Path, checksum: ChecksumType) -> None:
        self.user = User()
        local = LocalEntityConfig(ByteFieldU16(SPACE), IndicationConfig(), Faults())
        remote = RemoteEntityConfig(
            entity_id=ByteFieldU16(GROUND),
            max_file_segment_len=400,
            max_packet_len=512,
            closure_requested=False,
            crc_on_transmission=True,
            default_transmission_mode=TransmissionMode.ACKNOWLEDGED,
            crc_type=checksum,
            positive_ack_timer_interval_seconds=3.0,
            positive_ack_timer_expiration_limit=30,
            nak_timer_interval_seconds=3.0,
            nak_timer_expiration_limit=30,
        )
        table = RemoteEntityConfigTable([remote])
        self.dest = DestHandler(local, self.user, table, Timers())
        self.source = SourceHandler(local, self.user, table, Timers(), SeqCountProvider(16))

    def put(self, path: Path, name: str) -> None:
        self.source.put_request(
            PutRequest(
                destination_id=ByteFieldU16(GROUND),
                source_file=path,
                dest_file=Path(name),
                trans_mode=TransmissionMode.ACKNOWLEDGED,
                closure_requested=False,
            )
        )

    def work(self, octets: bytes | None) -> list[bytes]:
        """Take a PDU, or the time; return what it sends."""
        pdu = None if octets is None else PduFactory.from_raw(octets)
        if isinstance(pdu, EofPdu):
            # The package's parser leaves the code in the upper four bits.
            pdu.condition_code = ConditionCode(pdu.condition_code >> 4)
        sent = []
        for handler in (self.source, self.dest):
            to_dest = handler is self.dest
            own = pdu is not None and to_dest == (
                get_packet_destination(pdu) is PacketDestination.DEST_HANDLER
            )
            # Its transaction may be in another state, or over.
            with suppress(PduIgnoredForDest, PduIgnoredForSource, NoRemoteEntityConfigFound):
                handler.state_machine(pdu if own else None)
            while (packet := handler.get_next_packet()) is not None:
                sent.append(bytes(packet.pack()))
        return sent


def run(
    end: FileEnd, peer: Peer, monkeypatch, seed: int, seconds: float, loss: float, now_ns: int = 0
) -> int:
    random, seconds = Random(seed), seconds + now_ns / NS_PER_S
    clock = SimpleNamespace(time=lambda: now_ns / NS_PER_S)
    monkeypatch.setattr(countdown, "time", clock)
    to_peer: list[bytes] = []
    to_end: list[bytes] = []
    while now_ns < seconds * NS_PER_S:
        now_ns += STEP_NS
        end.entity.handle_link(heard=True, waiting_octets=0, now_ns=now_ns)
        for octets in to_end:
            end.entity.handle_pdu(octets, now_ns)
        arrived, to_peer = to_peer, [one for one in end.work(now_ns) if random.random() >= loss]
        to_end = [pdu for one in [*arrived, None] for pdu in peer.work(one)]
        to_end = [one for one in to_end if random.random() >= loss]
    return now_ns


@pytest.mark.parametrize(("seed", "loss"), LOSSES)
def test_our_sender_and_the_handler_of_others(tmp_path, monkeypatch, seed, loss) -> None:
    end = FileEnd(GROUND, SPACE, segment_octets=400)
    peer = Peer(tmp_path, ChecksumType.CRC_32)
    name = "taken.bin"
    end.files[name] = OCTETS
    monkeypatch.chdir(tmp_path)
    transfer = end.put(name)
    run(end, peer, monkeypatch, seed, 200, loss)
    assert (transfer.state, transfer.reason) == (DONE, "")
    assert (tmp_path / name).read_bytes() == OCTETS


@pytest.mark.parametrize(("seed", "loss"), LOSSES)
@pytest.mark.parametrize("checksum", [ChecksumType.CRC_32, ChecksumType.MODULAR])
def test_the_sender_of_others_and_our_receiver(tmp_path, monkeypatch, seed, loss, checksum) -> None:
    end = FileEnd(GROUND, SPACE)
    peer = Peer(tmp_path, checksum)
    source = tmp_path / "sent.bin"
    source.write_bytes(OCTETS)
    peer.put(source, "kept/given.bin")
    run(end, peer, monkeypatch, seed, 200, loss)
    assert end.files == {"kept/given.bin": OCTETS}
    (finished,) = peer.user.finished
    assert finished.condition_code == 0


@pytest.mark.parametrize("ours", [True, False])
def test_a_file_that_is_cancelled_here_ends_at_the_handler_of_others(
    tmp_path, monkeypatch, ours
) -> None:
    end = FileEnd(GROUND, SPACE, segment_octets=400)
    peer = Peer(tmp_path, ChecksumType.CRC_32)
    monkeypatch.chdir(tmp_path)
    if ours:
        end.files["cut.bin"] = OCTETS
        transfer = end.put("cut.bin")
    else:
        (tmp_path / "sent.bin").write_bytes(OCTETS)
        peer.put(tmp_path / "sent.bin", "given.bin")
    now_ns = run(end, peer, monkeypatch, 1, 0.5, 0.0)
    if ours:
        end.entity.cancel(transfer.number, now_ns)
    else:
        (receiver,) = end.entity._receivers.values()
        receiver.cancel(now_ns)
    run(end, peer, monkeypatch, 1, 20, 0.0, now_ns)
    (finished,) = peer.user.finished
    assert finished.condition_code == ConditionCode.CANCEL_REQUEST_RECEIVED
    assert not end.entity.open and "given.bin" not in end.files
