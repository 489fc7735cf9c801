"""Logs that were made to do harm, each found by `bench_fuzz.py`: one line of error, soon, and within memory."""

import gzip
import io
import json
import struct

import lz4.frame
import numpy as np
import pytest
import zstandard
from mcap.writer import CompressionType, Writer

from frasa_sysid.errors import InputError, LogError
from frasa_sysid.readers import read_log
from frasa_sysid.readers.columns import read_columns
from frasa_sysid.readers.csv_columns import LONGEST_LINE, CsvFile
from frasa_sysid.readers.npz_columns import NpzFile
from frasa_sysid.readers.signal_entry import make_entry
from frasa_sysid.readers.signal_map import load_map, parse_map
from frasa_sysid.readers.sources import read_bytes
from frasa_sysid.recording import Fault
from frasa_sysid.servo import read_servo

MAGIC = b"\x89MCAP0\r\n"
ZEROS = bytes(40 * 2**20)
S = 10**9
MAP = b"""
[time]
column = "t"
unit = "s"
[[signal]]
column = "q_*"
signal = "position"
unit = "rad"
"""

ENTRY = b'[[signal]]\ncolumn = "q"\nsignal = "position"\nunit = "rad"\n'


def record(opcode, body):
    return struct.pack("<BQ", opcode, len(body)) + body


def chunk(claimed, compression, data):
    name = compression.encode()
    head = struct.pack("<QQQI", 0, 1, claimed, 0) + struct.pack("<I", len(name)) + name + struct.pack("<Q", len(data))
    return MAGIC + record(1, bytes(8)) + record(6, head + data)


def zstd():
    packer = zstandard.ZstdCompressor(write_content_size=False).compressobj()
    return packer.compress(ZEROS) + packer.flush()


def log(path, metadata=(), schema=None, payload=b'{"name": ["a"], "position": [1.0]}'):
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE, enable_crcs=False)
        writer.start()
        for fields in metadata:
            writer.add_metadata("frasa.bench", fields)
        number = 0 if schema is None else writer.register_schema("sensor_msgs/msg/JointState", "ros2msg", schema)
        channel = writer.register_channel("/joint_states", "json" if schema is None else "cdr", number)
        for i in range(5):
            writer.add_message(channel, S + i, payload, S + i)
        writer.finish()
    return path


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (chunk(100, "lz4", lz4.frame.compress(ZEROS)), "unpacks to 101 bytes, it claims 100"),
        (chunk(100, "zstd", zstd()), "is damaged"),
        (chunk(2**25, "lz4", lz4.frame.compress(ZEROS))[:-3], "no messages"),
        (chunk(2**25, "zstd", zstd())[:-3], "no messages"),
        (chunk(9 * 20_000, "", record(0x7F, b"") * 20_000), "10001 records inside the chunk that are no messages"),
    ],
)
def test_chunks_that_unpack_to_more(tmp_path, content, complaint):
    """No more is unpacked than a chunk claims; one of millions of records without a meaning is left at once."""
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    with pytest.raises(LogError, match=complaint):
        read_log(path)


@pytest.mark.parametrize(
    ("fields", "complaint"),
    [
        ({"extra": '{"clocks": 5}'}, "'clocks' of extra is no list of objects"),
        ({"extra": '{"clocks": [1]}'}, "'clocks' of extra is no list of objects"),
        ({"extra": '{"a":' * 50_000}, "cannot be understood"),
        ({"faults": '[["a", 1e999, "b"]]'}, "cannot convert float infinity"),
        ({"faults": '[["a", NaN, "b"]]'}, "cannot convert float NaN"),
    ],
)
def test_facts_that_nothing_expects(tmp_path, fields, complaint):
    """A record made by hand has no checksum: its fields are looked at where they are read."""
    with pytest.raises(LogError, match=complaint):
        read_log(log(tmp_path / "a.mcap", [fields]))


def test_huge_numbers_of_a_record(tmp_path):
    """A truth or extra that no float can hold is infinite, not an error far from here; a fault's text is one line."""
    fields = {"truth": f'{{"kp": {"9" * 400}}}', "extra": f'{{"clock": {{"exchange_ms": {"9" * 400}}}}}'}
    found = read_log(log(tmp_path / "a.mcap", [{**fields, "faults": '[["a", 1, "b\\nc\\u001b[31m"]]'}]))[0]
    assert found.truth == {"kp": np.inf}
    assert found.extra["clock"] == {"exchange_ms": np.inf}
    assert found.faults[0] == Fault("a", 1, "b c [31m")


def test_more_runs_than_a_log_has(tmp_path):
    """Each run is looked for in all messages: thousands of them are refused."""
    runs = [{"run": str(i), "start_ns": "1", "end_ns": str(2**62)} for i in range(5001)]
    with pytest.raises(LogError, match=r"5001 frasa\.bench records, expected at most 5000"):
        read_log(log(tmp_path / "a.mcap", runs))


def test_a_definition_of_thousands_of_fields(tmp_path, capfd):
    """It is not parsed, which takes minutes; what the parser prints of others is not shown either."""
    for text in (b"float64 x\n" * 10_000, b"float64 __class__\n"):
        with pytest.raises(LogError, match="definition cannot be parsed"):
            read_log(log(tmp_path / "a.mcap", schema=text))
    assert capfd.readouterr().err == ""


def test_stars_of_a_map_end():
    """Any number of stars in a topic is matched in time that grows with its length only."""
    row = {"field": "x", "signal": "position", "unit": "rad"}
    for pattern in ("*" * 40 + "x" + "*" * 40, "*a" * 30 + "b"):
        assert make_entry("m", {**row, "topic": pattern}).match("a" * 2000) is None
    entry = make_entry("m", {**row, "topic": "/*/state/*"})
    assert entry.match("/left/arm/state/x") == "left/armx"
    assert entry.match("/left/state") is None
    column = make_entry("m", {"column": "q_*_deg", "signal": "position", "unit": "deg"})
    assert (column.match("q_knee_deg"), column.match("q__deg")) == ("knee", None)


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (b"rate = 0x" + b"f" * 6000, "a whole number of more than 64 bits"),
        (ENTRY + b"[time]\nrate = 0x" + b"f" * 6000, "a whole number of more than 64 bits"),
        (ENTRY + b"[time]\ncolumn = 0x" + b"f" * 6000, "a whole number of more than 64 bits"),
        (b"a" * 5000 + b" = 1", "unknown key 'a{60}'"),
        (b"x = 2020-99-99", "is not TOML"),
        (b"a." * 40_000 + b"b = 1", "larger than 64 KiB"),
        (b"a." * 20_000 + b"b = 1", "a key of more than 20 parts"),
        (b"x = {" + b"'a' . " * 9000 + b"b = 1}", "a key of more than 20 parts"),
    ],
)
def test_maps_that_were_made_to_do_harm(tmp_path, content, complaint):
    """Numbers of thousands of digits, long keys, dates that are none."""
    path = tmp_path / "a.toml"
    path.write_bytes(content)
    with pytest.raises(InputError, match=complaint) as found:
        load_map(str(path))
    assert str(found.value).isprintable()
    assert len(str(found.value)) < 500


def test_a_folder_for_a_map(tmp_path):
    """It is not taken for the name of a map that comes with frasa."""
    with pytest.raises(InputError, match="is a folder, expected a file"):
        load_map(str(tmp_path))


def test_tables_that_unpack_to_more(tmp_path):
    """Packed files have unpacked at most two hundred times their size, and lines at most a million characters."""
    path = tmp_path / "a.csv"
    path.write_bytes(gzip.compress(b"t,q_a\n" + b"1,2\n" * 10**6))
    with pytest.raises(LogError, match="unpacks to more than 200 times its size"):
        read_columns(CsvFile(path), parse_map("m", MAP, False))
    with pytest.raises(LogError, match="unpacks to more than 200 times its size"):
        read_bytes(path)
    for content in (b"1" * LONGEST_LINE, b"t,q_a\n" + b"1" * LONGEST_LINE):
        path.write_bytes(content)
        with pytest.raises(LogError, match="a line of more than"):
            read_columns(CsvFile(path), parse_map("m", MAP, False))
    path.write_bytes(b",".join(b"a%d" % i for i in range(11_000)))
    with pytest.raises(LogError, match="11000 columns, expected at most 10000"):
        CsvFile(path)


def test_arrays_of_text(tmp_path):
    """Times may be texts, numbers may not."""
    file = io.BytesIO()
    np.savez(file, t=np.arange(3) / 3, q_a=np.array(["1", "x", "2"]))
    (tmp_path / "a.npz").write_bytes(file.getvalue())
    with pytest.raises(LogError, match="q_a is <U1"):
        read_columns(NpzFile(tmp_path / "a.npz"), parse_map("m", MAP, False))


def test_errors_are_one_line():
    """Whatever a file made them quote: no line breaks, no control characters, no pages of it."""
    text = str(LogError("a: found 'b\nc\x1b[31m\x00'" + json.dumps("x" * 10_000) + "end"))
    assert text.isprintable()
    assert len(text) <= 1500
    assert text.startswith("a: found 'b c [31m '")
    assert text.endswith("end")


def test_servo_tables_are_bounded_too(tmp_path):
    """A key of thousands of parts took gigabytes; a number of thousands of digits could not be quoted."""
    path = tmp_path / "a.toml"
    for content, complaint in (
        (b"a." * 20_000 + b"b = 1", "a key of more than 20 parts"),
        (b'schema = "frasa.servo/1"\nname = 0x' + b"f" * 6000, "more than 64 bits"),
        (b"#" * 2**17, "expected a small TOML file"),
    ):
        path.write_bytes(content)
        with pytest.raises(InputError, match=complaint):
            read_servo(path)
