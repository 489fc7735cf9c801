"""Hostile logs of messages: MCAP and ROS bags."""

import io
import json
import sqlite3
import struct
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

import lz4.frame
import zstandard
from mcap.writer import CompressionType, Writer

from fuzzing import bombs, seeds_messages
from fuzzing.case import Case, single

MAGIC = b"\x89MCAP0\r\n"
HUGE = 3 * 2**30


def _record(opcode: int, body: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(body)) + body


def _chunk(claimed: int, compression: str, data: bytes) -> bytes:
    name = compression.encode()
    head = struct.pack("<QQQI", 0, 1, claimed, 0) + struct.pack("<I", len(name)) + name + struct.pack("<Q", len(data))
    return MAGIC + _record(1, struct.pack("<I", 0) + struct.pack("<I", 0)) + _record(6, head + data)


@cache
def _zstd(megabytes: int, sized: bool) -> bytes:
    packer = zstandard.ZstdCompressor(level=3, write_content_size=sized)
    if sized:
        return packer.compress(bytes(megabytes * 2**20))
    stream = packer.compressobj()
    return b"".join([*(stream.compress(bytes(2**20)) for _ in range(megabytes)), stream.flush()])


@cache
def _lz4(megabytes: int) -> bytes:
    packer = lz4.frame.LZ4FrameCompressor(block_size=lz4.frame.BLOCKSIZE_MAX4MB)
    parts = [packer.begin(), *(packer.compress(bytes(2**22)) for _ in range(megabytes // 4)), packer.flush()]
    return b"".join(parts)


def _chunks() -> list[Case]:
    bomb, plain, lz = _zstd(600, True), _zstd(3000, False), _lz4(3000)
    made = {
        "claims 2^63": _chunk(2**63, "zstd", b"x" * 50),
        "claims 3 GB": _chunk(HUGE, "", b"x" * 50),
        "zstd bomb": _chunk(100, "zstd", bomb),
        "zstd bomb without a size": _chunk(2**27, "zstd", plain),
        "zstd bomb cut off": _chunk(2**27, "zstd", plain)[:-3],
        "lz4 bomb": _chunk(2**27, "lz4", lz),
        "lz4 bomb cut off": _chunk(2**27, "lz4", lz)[:-3],
        "record of 2^62 bytes": MAGIC + struct.pack("<BQ", 5, 2**62) + MAGIC,
        "empty": b"",
        "magic alone": MAGIC,
        "magic twice": MAGIC * 2,
        "no kind": MAGIC + bytes(1000),
    }
    refused = [single(one, "a.mcap", note, refuse=True) for note, one in made.items()]
    return [*refused, Case({"a.mcap": None}, "a.mcap", "a folder", refuse=True)]


def _with_record(**more: str) -> bytes:
    return seeds_messages.plain_ros2(extra={**seeds_messages.RECORD, **more})


def _records() -> list[Case]:
    """Facts of the bench, made by hand, that nothing downstream expects."""
    odd = {
        "clocks a number": {"extra": '{"clocks": 5}'},
        "clocks a list of numbers": {"extra": '{"clocks": [1, 2]}'},
        "clocks without fields": {"extra": '{"clocks": [{}]}'},
        "clocks with texts": {"extra": '{"clocks": [{"of": 1, "against": [], "drift_ppm": "x"}]}'},
        "clock a number": {"extra": '{"clock": 5, "joint": 7, "note": [1]}'},
        "extra a list": {"extra": "[]"},
        "extra nested": {"extra": '{"a":' * 50_000},
        "faults without end": {"faults": '[["a", 1e999, "b"]]'},
        "faults nan": {"faults": '[["a", NaN, "b"]]'},
        "faults of two lines": {"faults": '[["a", 1, "b\\nc\\u001b[31m"]]'},
        "truth huge": {"truth": '{"kp": ' + "9" * 400 + "}"},
        "truth nan": {"truth": '{"kp": NaN}'},
        "mass huge": {"mass": "1e308", "length": "1e308"},
        "window backwards": {"start_ns": "5", "end_ns": "1"},
        "window of digits": {"end_ns": "9" * 5000},
        "servo of markup": {"servo": "[red]x[/red]\n"},
    }
    return [single(_with_record(**fields), "a.mcap", note) for note, fields in odd.items()]


def _many_runs() -> Case:
    """As many runs as fit into some MB, each with all messages in its window."""
    file = io.BytesIO()
    writer = Writer(file, compression=CompressionType.NONE, enable_crcs=False)
    writer.start()
    for i in range(30_000):
        writer.add_metadata("frasa.bench", {**seeds_messages.RECORD, "run": str(i)})
    schema = 0
    channel = writer.register_channel("/joint_states", "json", schema)
    for i in range(2000):
        at = 1_577_836_800 * 10**9 + i * 10**7
        writer.add_message(channel, at, b'{"name": ["a", "b"], "position": [0.1, 0.2]}', at)
    writer.finish()
    return single(file.getvalue(), "a.mcap", "30 000 runs", refuse=True)


def _schemas() -> list[Case]:
    """Definitions that make decoders loop or grow."""
    head = "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n"
    line = "=" * 80
    empty = f"{line}\nMSG: a/Empty\n\n"
    texts = {
        "array of empty messages": f"a/Empty[4000000000] xs\n{head}{empty}",
        "sequence of empty messages": f"a/Empty[] xs\n{head}{empty}",
        "array of 4e9 numbers": f"float64[4000000000] xs\n{head}",
        "nested arrays": f"a/A[60000] xs\n{head}{line}\nMSG: a/A\na/B[60000] y\n{line}\nMSG: a/B\nuint8 z\n",
        "itself": f"sensor_msgs/JointState x\n{head}",
        "default of 4e9": f"float64[<=4000000000] xs\n{head}",
        "code in a name": "float64 __class__\nfloat64 x;import os\n" + head,
        "code in a default": "string s \"'+__import__('os').system('touch x')+'\"\n" + head,
        "long": head * 3000,
    }
    found = []
    for note, text in texts.items():
        file = io.BytesIO()
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start()
        schema = writer.register_schema("sensor_msgs/msg/JointState", "ros2msg", text.encode())
        channel = writer.register_channel("/joint_states", "cdr", schema)
        for i in range(20):
            writer.add_message(channel, 10**9 + i, b"\x00\x01\x00\x00" + b"\xff" * 200, 10**9 + i)
        writer.finish()
        found.append(single(file.getvalue(), "a.mcap", note))
    return found


def _payloads(encoding: str) -> list[Case]:
    nested = b"[" * 100_000 if encoding == "json" else b"\x91" * 100_000
    made = {
        "nested": nested,
        "nested objects": b'{"a":' * 100_000 if encoding == "json" else b"\x81\xa1a" * 100_000,
        "many": b"[" + b"[]," * 500_000 + b"1]" if encoding == "json" else b"\xdd\xff\xff\xff\xff" + b"\x90" * 100,
        "huge number": b'{"name": ["a"], "position": [' + b"9" * 5000 + b"]}"
        if encoding == "json"
        else b"\xc7\xff\x05" * 99,
        "names of names": b'{"__class__": {"__init__": 1}, "name": [[1]], "position": {"__len__": 5}}',
        "stamp": json.dumps(
            {"header": {"stamp": {"sec": 10**400, "nanosec": -5}}, "name": ["a"], "position": [1]}
        ).encode(),
    }
    found = []
    for note, data in made.items():
        file = io.BytesIO()
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start()
        channel = writer.register_channel("/joint_states", encoding, 0)
        for i in range(5):
            writer.add_message(channel, 10**9 + i, data, 10**9 + i)
        writer.finish()
        found.append(single(file.getvalue(), "a.mcap", note))
    return found


def _sql(*commands: str) -> bytes:
    """A .db3 that was changed with SQL."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.db3"
        path.write_bytes(next(iter(seeds_messages.bags()["db3"][0].files.values())) or b"")
        with sqlite3.connect(path) as base:
            for command in commands:
                base.execute(command)
        base.close()
        return path.read_bytes()


def _bases() -> list[Case]:
    endless = "WITH RECURSIVE n(i) AS (SELECT 0 UNION ALL SELECT i + 1 FROM n)"
    blob = "x'" + "00" * 100 + "'"
    view = "CREATE VIEW messages AS {} SELECT i AS id, 1 AS topic_id, i AS timestamp, {} AS data FROM n"
    made = {
        "endless view": ("ALTER TABLE messages RENAME TO other", view.format(endless, blob)),
        "endless definitions": (
            "DROP TABLE message_definitions",
            f"CREATE VIEW message_definitions AS {endless} SELECT i AS id, 'a' AS topic_type, 'ros2msg' AS encoding, "
            "'b' AS encoded_message_definition, 'c' AS type_description_hash FROM n",
        ),
        "a blob of 1 GB": ("UPDATE messages SET data = zeroblob(900000000) WHERE id = 1",),
        "texts for numbers": ("UPDATE messages SET timestamp = 'x'",),
        "numbers for texts": ("UPDATE topics SET name = 5, type = x'ff'",),
        "no type": ("UPDATE topics SET type = ''",),
        "definition of code": (
            "UPDATE message_definitions SET encoded_message_definition = 'float64 x\nstring S=''+__import__(0)'",
        ),
    }
    return [single(_sql(*commands), "a.db3", note) for note, commands in made.items() if note != "a blob of 1 GB"]


def _bag_header(**fields: bytes) -> bytes:
    parts = b"".join(
        struct.pack("<I", len(name) + 1 + len(one)) + name.encode() + b"=" + one for name, one in fields.items()
    )
    return struct.pack("<I", len(parts)) + parts


def _bags() -> list[Case]:
    """ROS 1: a chunk that unpacks to gigabytes, in a bag that is right otherwise; odd definitions."""
    found = []
    for kind, data in ((b"bz2", bombs.bz2_bomb()), (b"lz4", _lz4(3000))):
        found.append(single(_bag_of(kind, data, 1000), "a.bag", f"{kind.decode()} bomb"))
    found.append(single(_bag_of(b"none", b"x" * 100, 2**32 - 1), "a.bag", "claims 4 GB"))
    found.append(single(b"#ROSBAG V2.0\n", "a.bag", "head alone", refuse=True))
    found.append(single(b"#ROSBAG V2.0\n" + b"\xff" * 200, "a.bag", "header of 4 GB", refuse=True))
    for note, text in {
        "array of empty messages": b"a/Empty[4000000000] xs\nfloat64[] position\n" + b"=" * 80 + b"\nMSG: a/Empty\n",
        "array of 4e9": b"float64[4000000000] position\n",
        "code": b"float64 x\nstring S='''+__import__('os').system('touch x')#\n",
    }.items():
        found.append(single(_bag_of(b"none", None, None, text), "a.bag", note))
    return found


def _bag_of(
    compression: bytes, data: bytes | None, claimed: int | None, text: bytes = b"float64[] position\n"
) -> bytes:
    """A bag of one connection and one chunk with one message of 0xff."""
    topic, kind = b"/joint_states", b"sensor_msgs/JointState"
    inner = _bag_header(topic=topic, type=kind, md5sum=b"*", message_definition=text)
    connection = (
        _bag_header(op=b"\x07", conn=struct.pack("<I", 0), topic=topic) + struct.pack("<I", len(inner) - 4) + inner[4:]
    )
    message = _bag_header(op=b"\x02", conn=struct.pack("<I", 0), time=struct.pack("<II", 1, 1))
    message += struct.pack("<I", 64) + b"\xff" * 64
    content = data if data is not None else connection + message
    size = claimed if claimed is not None else len(content)
    chunk = _bag_header(op=b"\x05", compression=compression, size=struct.pack("<I", size))
    chunk += struct.pack("<I", len(content)) + content
    index = _bag_header(op=b"\x04", ver=struct.pack("<I", 1), conn=struct.pack("<I", 0), count=struct.pack("<I", 1))
    index += struct.pack("<I", 12) + struct.pack("<III", 1, 1, len(connection))
    start = 13 + 4096
    info = _bag_header(
        op=b"\x06", ver=struct.pack("<I", 1), chunk_pos=struct.pack("<Q", start), start_time=struct.pack("<II", 1, 1),
        end_time=struct.pack("<II", 2, 1), count=struct.pack("<I", 1),
    ) + struct.pack("<III", 8, 0, 1)  # fmt: skip
    position = start + len(chunk) + len(index)
    head = _bag_header(
        op=b"\x03", index_pos=struct.pack("<Q", position), conn_count=struct.pack("<I", 1),
        chunk_count=struct.pack("<I", 1),
    )  # fmt: skip
    padded = head + struct.pack("<I", 4096 - len(head) - 4) + b" " * (4096 - len(head) - 4)
    return b"#ROSBAG V2.0\n" + padded + chunk + index + connection + info


def _folders() -> list[Case]:
    good = {one.note: one for one in seeds_messages.bags()["bag_folder"]}
    plain, packed = good["db3"], good["file"]
    meta = (plain.files["metadata.yaml"] or b"").decode()
    base = next(name for name in plain.files if name.endswith(".db3"))
    bomb = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
        f"{chr(98 + i)}: &{chr(98 + i)} [{', '.join(['*' + chr(97 + i)] * 9)}]\n" for i in range(12)
    )
    member = next(name for name in packed.files if name.endswith(".zstd"))
    mcap = good["mcap"]
    log = next(name for name in mcap.files if name.endswith(".mcap"))
    odd = {
        "climbs out": (plain, {"metadata.yaml": meta.replace(base, f"../../../{base}").encode()}, False),
        "billion laughs": (plain, {"metadata.yaml": (meta + bomb).encode()}, True),
        "nested": (plain, {"metadata.yaml": b"[" * 100_000}, True),
        "code": (plain, {"metadata.yaml": b"!!python/object/apply:os.system ['touch x']\n" + meta.encode()}, True),
        "zstd bomb": (packed, {member: _zstd(3000, False)}, True),
        "mcap with a bomb": (mcap, {log: _chunk(2**27, "lz4", _lz4(3000))}, True),
        "not a text": (plain, {"metadata.yaml": b"\xff\xfe\x00"}, True),
    }
    return [Case({**one.files, **files}, one.entry, note, refuse) for note, (one, files, refuse) in odd.items()]


MADE: dict[str, Callable[[], list[Case]]] = {
    "mcap ros2": lambda: [*_chunks(), *_records(), *_schemas(), _many_runs()],
    "mcap json": lambda: _payloads("json"),
    "mcap msgpack": lambda: _payloads("msgpack"),
    "mcap by a map": lambda: _payloads("json"),
    "rosbag .db3": _bases,
    "rosbag .bag": _bags,
    "rosbag folder": _folders,
    "excitation": lambda: _records()[:6],
}
