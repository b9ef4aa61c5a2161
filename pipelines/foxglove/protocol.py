"""Foxglove's WebSocket protocol: what its clients send, and what they are sent. A core.

Source: github.com/foxglove/ws-protocol, docs/spec.md, version 1.
"""

from base64 import b64encode
from collections.abc import Iterable, Mapping, Sequence
from struct import Struct
from typing import Annotated, Final, NamedTuple

import msgspec

from kontur_av.errors import ProtocolError, refused
from pipelines.recording.channels import ChannelRow
from telepresence.malformed import MALFORMED

#: Both have the messages that are used here.
SUBPROTOCOLS: Final = ("foxglove.websocket.v1", "foxglove.sdk.v1")
#: The longest message of a client.
MOST_CLIENT_OCTETS: Final = 64 << 10
JSON: Final = "json"
_DATA, _RESPONSE = 1, 3
_CALL = 2
_DATA_HEAD = Struct("<BIQ")
_CALL_HEAD = Struct("<BIII")
WARNING: Final = 1

_Id = Annotated[int, msgspec.Meta(ge=0, lt=1 << 32)]
_Name = Annotated[str, msgspec.Meta(max_length=200)]
_Names = Annotated[list[_Name], msgspec.Meta(max_length=2000)]


class Subscription(msgspec.Struct, frozen=True, rename="camel"):
    """A client's number for a channel."""

    id: _Id
    channel_id: _Id


class _Text(msgspec.Struct, frozen=True, tag_field="op", rename="camel"):
    """A client's text; `op` says of which kind it is."""


class Subscribe(_Text, frozen=True, tag="subscribe"):
    """Send the messages of these channels from now on."""

    subscriptions: Annotated[list[Subscription], msgspec.Meta(max_length=500)]


class Unsubscribe(_Text, frozen=True, tag="unsubscribe"):
    """Send no more of these."""

    subscription_ids: Annotated[list[_Id], msgspec.Meta(max_length=500)]


class GetParameters(_Text, frozen=True, tag="getParameters"):
    """Tell the values of these parameters; none: of all."""

    parameter_names: _Names
    id: _Name | None = None


class SetParameters(_Text, frozen=True, tag="setParameters"):
    """Refused: all parameters are only to be read."""

    id: _Name | None = None


class FollowParameters(_Text, frozen=True, tag="subscribeParameterUpdates"):
    """Tell the values of these parameters when they change; none: of all."""

    parameter_names: _Names


class LeaveParameters(_Text, frozen=True, tag="unsubscribeParameterUpdates"):
    """Tell no more of these; none: of any."""

    parameter_names: _Names


ClientText = (
    Subscribe | Unsubscribe | GetParameters | SetParameters | FollowParameters | LeaveParameters
)


_TEXTS = msgspec.json.Decoder(ClientText)


class ServiceCall(NamedTuple):
    """Carry out a service. data: of the request, in `encoding`."""

    service: int
    call: int
    encoding: str
    data: bytes


class ServiceRow(NamedTuple):
    """A service. fields: of its request, all text, with what each is."""

    number: int
    name: str
    fields: Mapping[str, str]


Value = bool | int | float | str | list["Value"] | dict[str, "Value"] | None


def parse_text(text: str) -> ClientText:
    """Return a client's request; ProtocolError for anything else."""
    with refused("no request of a client", *MALFORMED, raising=ProtocolError):
        request: ClientText = _TEXTS.decode(text)
        return request


def parse_octets(octets: bytes) -> ServiceCall:
    """Return a client's call of a service; ProtocolError for anything else."""
    if len(octets) < _CALL_HEAD.size or octets[0] != _CALL:
        raise ProtocolError("no call of a service")
    _, service, call, length = _CALL_HEAD.unpack_from(octets)
    encoding, data = octets[_CALL_HEAD.size :][:length], octets[_CALL_HEAD.size + length :]
    if len(encoding) != length:
        raise ProtocolError("a call of a service is cut off")
    return ServiceCall(service, call, encoding.decode("utf-8", "replace"), data)


def parse_fields(row: ServiceRow, call: ServiceCall) -> Mapping[str, str]:
    """Return the fields of a request; ProtocolError for anything else."""
    if call.encoding != JSON:
        raise ProtocolError(f"{row.name} takes {JSON}, not {call.encoding[:20]!r}")
    with refused(row.name, *MALFORMED, raising=ProtocolError):
        given = msgspec.json.decode(call.data or b"{}", type=dict[_Name, _Name])
    if set(given) != set(row.fields):
        needs = ", ".join(row.fields) or "nothing"
        raise ProtocolError(f"{row.name} takes {needs}")
    return given


def server_info(name: str, session: str, *, commands: bool) -> str:
    """Return a server's first message. commands: whether the client may call services."""
    capabilities = ["parameters", "parametersSubscribe", *["services"] * commands]
    return _packed(
        "serverInfo",
        name=name,
        capabilities=capabilities,
        supportedEncodings=[JSON],
        metadata={},
        sessionId=session,
    )


def advertise(rows: Iterable[ChannelRow]) -> str:
    channels = []
    for row in rows:
        schema, channel = row.records()
        channels.append(
            {
                "id": channel.id,
                "topic": channel.topic,
                "encoding": channel.message_encoding,
                "schemaName": schema.name,
                "schema": b64encode(schema.data).decode(),
                "schemaEncoding": schema.encoding,
            }
        )
    return _packed("advertise", channels=channels)


def advertise_services(rows: Iterable[ServiceRow]) -> str:
    services = [
        {
            "id": row.number,
            "name": row.name,
            "type": row.name,
            "request": _schema(f"{row.name} request", row.fields, "string"),
            "response": _schema(
                f"{row.name} response", {"round_trip_ms": "until it was verified"}, "number"
            ),
        }
        for row in rows
    ]
    return _packed("advertiseServices", services=services)


def _schema(name: str, fields: Mapping[str, str], kind: str) -> dict[str, str]:
    schema = {
        "title": name,
        "type": "object",
        "properties": {key: {"type": kind, "description": what} for key, what in fields.items()},
    }
    return {
        "encoding": JSON,
        "schemaName": name,
        "schemaEncoding": "jsonschema",
        "schema": msgspec.json.encode(schema).decode(),
    }


def parameter_values(values: Mapping[str, Value], request: str | None = None) -> str:
    """Return values of parameters by name. None: the parameter has no value."""
    told: Sequence[dict[str, Value]] = [
        {"name": name} if value is None else {"name": name, "value": value}
        for name, value in values.items()
    ]
    return _packed(
        "parameterValues", parameters=told, **({} if request is None else {"id": request})
    )


def status(words: str) -> str:
    return _packed("status", level=WARNING, message=words)


def message_data(subscription: int, log_ns: int, data: bytes) -> bytes:
    return _DATA_HEAD.pack(_DATA, subscription, log_ns) + data


def service_response(service: int, call: int, round_trip_ms: float) -> bytes:
    head = _CALL_HEAD.pack(_RESPONSE, service, call, len(JSON))
    return head + JSON.encode() + msgspec.json.encode({"round_trip_ms": round_trip_ms})


def service_failure(service: int, call: int, words: str) -> str:
    return _packed("serviceCallFailure", serviceId=service, callId=call, message=words)


def _packed(op: str, **fields: object) -> str:
    return msgspec.json.encode({"op": op, **fields}).decode()
