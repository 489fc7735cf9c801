"""Bytes of a message -> plain objects: JSON, MessagePack and Protobuf; nothing in a message is ever executed."""

import json
from collections.abc import Callable, Mapping
from typing import Any

from mcap.records import Schema

from frasa_sysid.errors import LogError
from frasa_sysid.readers.fields import is_list

Unpack = Callable[[bytes], Any]
HINT = "install it with: pip install 'frasa[formats]'"


def json_unpack(schema: Schema | None) -> Unpack:
    """Of JSON, with or without a schema."""
    return json.loads


def msgpack_unpack(schema: Schema | None) -> Unpack:
    """Of MessagePack.

    Raises:
        LogError: the package that reads it is not installed.
    """
    try:
        import msgpack
    except ImportError:
        raise LogError(f"MessagePack messages need the package msgpack; {HINT}") from None
    # Keys may be numbers; lengths are checked against the bytes that are there, as is the library's default.
    return lambda data: msgpack.unpackb(data, raw=False, strict_map_key=False)


def protobuf_unpack(schema: Schema | None) -> Unpack | None:
    """Of Protobuf, by the descriptors in the schema.

    Raises:
        LogError: the package that reads it is not installed.
        Exception: whatever the library raises on descriptors that it cannot use.
    """
    try:
        from mcap_protobuf.decoder import DecoderFactory
    except ImportError:
        raise LogError(f"Protobuf messages need the package mcap-protobuf-support; {HINT}") from None
    decode = DecoderFactory().decoder_for("protobuf", schema)
    return None if decode is None else lambda data: _plain(decode(data))


def _plain(message: Any) -> dict[str, Any]:  # noqa: ANN401 - a generated message
    """A Protobuf message as a mapping; None for a field that was not set, where the format can tell."""
    return {field.name: _field(message, field) for field in message.DESCRIPTOR.fields}


def _field(message: Any, field: Any) -> Any:  # noqa: ANN401 - a generated message, its field's descriptor
    if field.has_presence and not message.HasField(field.name):
        return None
    value = getattr(message, field.name)
    if isinstance(value, Mapping):
        return {str(key): _single(one) for key, one in value.items()}
    return [_single(one) for one in value] if is_list(value) else _single(value)


def _single(value: Any) -> Any:  # noqa: ANN401
    return _plain(value) if hasattr(value, "DESCRIPTOR") else value


UNPACKS: Mapping[tuple[str, str], Callable[[Schema | None], Unpack | None]] = {
    ("json", "jsonschema"): json_unpack,
    ("json", ""): json_unpack,
    ("msgpack", ""): msgpack_unpack,
    ("messagepack", ""): msgpack_unpack,  # as HULKs call it
    ("protobuf", "protobuf"): protobuf_unpack,
}
