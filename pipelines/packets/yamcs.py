"""The files of an instance of YAMCS 5.12 that reads a session's packets and frames. A core.

What they say beside the usual services: the packets have a check (CRC-16-CCITT), and their time is
CUC of 4 and 2 octets without preamble (P-field 0x2E), at octet 13, in seconds of Unix time.

Frames are checked and counted by virtual channel (VCA service). What is in them has no CCSDS
packets, so the handler is one that drops it; whole frames are in the streams `downlink_frames` and
`uplink_frames`. The insert zone counts as data, because frames without a sample have none.
"""

from telepresence.link.frame import Pointers
from telepresence.link.profile import DOWNLINK, UPLINK, LinkProfile

#: Also the name of its space system; verifiers are functions, whose names may have no hyphen.
INSTANCE = "kontur_av"

_SERVER = """\
services:
  - class: org.yamcs.http.HttpServer
    args:
      address: 127.0.0.1
      port: {http_port}
dataDir: data
instances:
  - {instance}
"""

_PROCESSORS = """\
realtime:
  services:
    - class: org.yamcs.StreamTmPacketProvider
    - class: org.yamcs.StreamTcCommandReleaser
    - class: org.yamcs.tctm.StreamParameterProvider
    - class: org.yamcs.algorithms.AlgorithmManager
    - class: org.yamcs.parameter.LocalParameterManager
  config:
    subscribeAll: true
    alarm:
      parameterCheck: true
      parameterServer: enabled
Archive: &archive
  services:
    - class: org.yamcs.tctm.ReplayService
    - class: org.yamcs.algorithms.AlgorithmManager
ArchiveRetrieval: *archive
"""

_INSTANCE = """\
services:
  - class: org.yamcs.archive.XtceTmRecorder
  - class: org.yamcs.archive.ParameterRecorder
  - class: org.yamcs.archive.AlarmRecorder
  - class: org.yamcs.archive.EventRecorder
  - class: org.yamcs.archive.ReplayServer
  - class: org.yamcs.archive.CommandHistoryRecorder
  - class: org.yamcs.parameterarchive.ParameterArchive
  - class: org.yamcs.ProcessorCreatorService
    args:
      name: realtime
      type: realtime
mdb:
  - type: xtce
    args:
      file: mdb/{instance}.xml
streamConfig:
  tm:
    - name: tm_realtime
      processor: realtime
  tc:
    - name: tc_realtime
      processor: realtime
  cmdHist: [cmdhist_realtime]
  event: [events_realtime]
  param: [pp_realtime, sys_param, proc_param]
  parameterAlarm: [alarms_realtime]
dataLinks:
"""

_TELEMETRY = """\
    packetPreprocessorClassName: org.yamcs.pus.PusPacketPreprocessor
    packetPreprocessorArgs:
      errorDetection:
        type: CRC-16-CCIIT
      pktTimeOffset: 13
      timeEncoding:
        type: CUC
        implicitPField: 0x2E
        epoch: UNIX
"""

_TELECOMMANDS = """\
    commandPostprocessorClassName: org.yamcs.pus.PusCommandPostprocessor
    commandPostprocessorArgs:
      errorDetection:
        type: CRC-16-CCIIT
"""

_TCP = """\
  - name: session
    class: org.yamcs.tctm.TcpTcTmDataLink
    host: {host}
    port: {port}
    tmStream: tm_realtime
    tcStream: tc_realtime
    packetInputStreamClassName: org.yamcs.tctm.CcsdsPacketInputStream
"""

_UDP_TM = """\
  - name: telemetry
    class: org.yamcs.tctm.UdpTmDataLink
    port: {port}
    stream: tm_realtime
"""

_UDP_TC = """\
  - name: telecommands
    class: org.yamcs.tctm.UdpTcDataLink
    host: {host}
    port: {port}
    stream: tc_realtime
"""


_FRAMES = """\
  - name: {name}
    class: org.yamcs.tctm.ccsds.UdpTmFrameLink
    port: {port}
    frameType: AOS
    spacecraftId: {scid}
    frameLength: {octets}
    insertZoneLength: 0
    frameHeaderErrorControlPresent: false
    errorDetection: CRC16
    goodFrameStream: {name}_frames
    virtualChannels:
"""

_CHANNEL = """      - vcId: {vcid}
        service: VCA
        vcaHandlerClassName: org.yamcs.tctm.ccsds.IdleFrameHandler
        ocfPresent: false
"""


def instance_files(
    xtce: str, session: tuple[str, int], *, udp: bool, frames_port: int | None, http_port: int
) -> dict[str, str]:
    """Return the texts of the files, by their path in the instance's directory.

    session: host and port of `--packets`. udp: it sends datagrams to that port; else it listens
    there. frames_port: where frames of the downlink come; those of the uplink at the next.
    """
    host, port = session
    if udp:
        links = _UDP_TM.format(port=port) + _TELEMETRY
        links += _UDP_TC.format(host=host, port=port + 1) + _TELECOMMANDS
    else:
        links = _TCP.format(host=host, port=port) + _TELEMETRY + _TELECOMMANDS
    if frames_port is not None:
        links += _frame_link(DOWNLINK, frames_port) + _frame_link(UPLINK, frames_port + 1)
    return {
        "etc/yamcs.yaml": _SERVER.format(instance=INSTANCE, http_port=http_port),
        f"etc/yamcs.{INSTANCE}.yaml": _INSTANCE.format(instance=INSTANCE) + links,
        "etc/processor.yaml": _PROCESSORS,
        f"mdb/{INSTANCE}.xml": xtce,
    }


def _frame_link(profile: LinkProfile, port: int) -> str:
    pointers = Pointers(profile).no_start if profile.pointer_in_vcid else 0
    link = _FRAMES.format(
        name=profile.name, port=port, scid=profile.scid, octets=profile.frame_octets
    )
    vcids = range(profile.vcid, profile.vcid + pointers + 1)
    return link + "".join(_CHANNEL.format(vcid=vcid) for vcid in vcids)
