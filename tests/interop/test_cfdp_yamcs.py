"""Files to and from YAMCS' CfdpService, class 2 over UDP, while PDUs are lost both ways.

YAMCS reads the wall clock, so this test has real time. It knows modular checksums only.
"""

import socket
import time
from random import Random

from common import TIMEOUT_S, eventually
from file_pair import GROUND, SPACE, FileEnd
from running_session import free_pair, tcp_port
from yamcs import Yamcs

from telepresence.files.entity import DONE, FAILED
from telepresence.files.pdus import ChecksumType
from telepresence.link.frame import MAX_PACKET_OCTETS

OCTETS = Random(1).randbytes(6_000)
LOSS = 0.15

SERVER = """\
services:
  - class: org.yamcs.http.HttpServer
    args: {{address: 127.0.0.1, port: {http}}}
dataDir: data
instances: [kontur_av]
buckets:
  - {{name: up, path: up}}
  - {{name: down, path: down}}
"""
INSTANCE = """\
services:
  - class: org.yamcs.cfdp.CfdpService
    name: cfdp
    args:
      incomingBucket: down
      sleepBetweenPdus: 20
      eofAckTimeout: 500
      eofAckLimit: -1
      finAckTimeout: 500
      finAckLimit: -1
      nakTimeout: 500
      localEntities: [{{name: yamcs, id: {space}}}]
      remoteEntities: [{{name: ours, id: {ground}}}]
dataLinks:
  - name: in
    class: org.yamcs.tctm.UdpTmDataLink
    stream: pdus_in
    port: {into}
    packetPreprocessorClassName: org.yamcs.tctm.GenericPacketPreprocessor
    packetPreprocessorArgs:
      errorDetection: none
      useLocalGenerationTime: true
      seqCountOffset: -1
      timestampOffset: -1
  - name: out
    class: org.yamcs.tctm.UdpTcDataLink
    stream: pdus_out
    host: 127.0.0.1
    port: {out}
mdb: [{{type: emptyNode, args: {{name: kontur_av}}}}]
streamConfig:
  tm: [{{name: pdus_in}}]
  tc: [{{name: pdus_out}}]
  cmdHist: [cmdhist_realtime]
  event: [events_realtime]
  param: [pp_realtime, sys_param]
  sqlFile: etc/streams.sql
"""
STREAMS = """\
create stream cfdp_in as select packet as pdu from pdus_in
create stream cfdp_out (gentime TIMESTAMP, entityId long, seqNum int, pdu binary)
insert into pdus_out select gentime, 'cfdp' as origin, seqNum, '/cfdp' as cmdName, \
pdu as binary from cfdp_out
"""


def run(end, udp, address, ended, seed):
    """Carry PDUs between our entity and YAMCS until all has ended; return how many were lost."""
    random, lost, deadline_s = Random(seed), 0, time.monotonic() + 3 * TIMEOUT_S
    while not ended():
        assert time.monotonic() < deadline_s, f"a file did not come; seed {seed}"
        now_ns = time.monotonic_ns()
        end.entity.handle_link(heard=True, waiting_octets=0, now_ns=now_ns)
        while True:
            try:
                pdu = udp.recv(MAX_PACKET_OCTETS)
            except BlockingIOError:
                break
            if random.random() >= LOSS:
                end.entity.handle_pdu(pdu, now_ns)
            else:
                lost += 1
        for pdu in end.work(now_ns):
            if random.random() >= LOSS:
                udp.sendto(pdu, address)
            else:
                lost += 1
        time.sleep(0.01)
    return lost


def test_files_go_both_ways_while_pdus_are_lost(tmp_path):
    http, into = tcp_port(), free_pair()
    out = into + 1
    for directory in ("etc", "up", "down"):
        (tmp_path / directory).mkdir()
    values = {"http": http, "into": into, "out": out, "ground": GROUND, "space": SPACE}
    files = {"yamcs.yaml": SERVER, "yamcs.kontur_av.yaml": INSTANCE, "streams.sql": STREAMS}
    for name, text in files.items():
        (tmp_path / "etc" / name).write_text(text.format(**values))
    (tmp_path / "etc" / "processor.yaml").write_text("{}\n")
    (tmp_path / "up" / "up.bin").write_bytes(OCTETS)
    path = "filetransfer/kontur_av/cfdp/transfers"
    with Yamcs(tmp_path, http) as yamcs, socket.socket(type=socket.SOCK_DGRAM) as udp:
        udp.bind(("127.0.0.1", out))
        udp.setblocking(False)
        eventually(yamcs.is_there, "the start of YAMCS", 3 * TIMEOUT_S)
        end = FileEnd(
            GROUND, SPACE, time.monotonic_ns(), checksum=ChecksumType.MODULAR, repeat_ns=500_000_000
        )
        end.files["down.bin"] = OCTETS[::-1]
        down = end.put("down.bin", time.monotonic_ns())
        sent = {"direction": "UPLOAD", "bucket": "up", "objectName": "up.bin"}
        up = yamcs.post(path, {**sent, "remotePath": "up.bin", "options": {"reliable": True}})

        def transfers():
            return {one.get("objectName"): one for one in yamcs.get(path).get("transfers", [])}

        def ended():
            over = down.state in (DONE, FAILED) and "up.bin" in end.files
            return over and all(transfer["state"] != "RUNNING" for transfer in transfers().values())

        lost = run(end, udp, ("127.0.0.1", into), ended, seed=1)
        assert (down.state, down.reason) == (DONE, "")
        assert {name: one["state"] for name, one in transfers().items()} == {
            "up.bin": "COMPLETED",
            "down.bin": "COMPLETED",
        }
        assert up["reliable"]
    assert end.files["up.bin"] == OCTETS
    assert (tmp_path / "down" / "down.bin").read_bytes() == OCTETS[::-1]
    assert lost
