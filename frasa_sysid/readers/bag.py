"""ROS 1 bags, rosbag2 `.db3` files and rosbag2 folders -> recordings, through the `rosbags` package; no ROS is needed.

Only topics that are read are fetched, one message at a time, and an odd topic costs no other. Bags before ROS 2 Iron
hold no message definitions: those of the standard packages come with `rosbags`, those of control_msgs and bitbots_msgs
stand here. ROS 2 messages are decoded as those of MCAP files are.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager, redirect_stderr, suppress
from dataclasses import replace
from io import StringIO
from pathlib import Path
from typing import Any

from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory

from frasa_sysid.calibration import read_yaml
from frasa_sysid.calibration.files import sha256_of, sha256_of_file
from frasa_sysid.errors import LogError
from frasa_sysid.message_definitions import DEFINITIONS
from frasa_sysid.readers.bag_bounds import bind, check_definitions
from frasa_sysid.readers.bag_definitions import LEGACY
from frasa_sysid.readers.bag_tables import check_tables
from frasa_sysid.readers.decoders import Decode, Extract, extract_ros
from frasa_sysid.readers.kept_windows import KeptWindows, Limit
from frasa_sysid.readers.mapped import extractor_of
from frasa_sysid.readers.mcap import recordings_of
from frasa_sysid.readers.mcap_series import Collected, take
from frasa_sysid.readers.payloads import Unpack
from frasa_sysid.readers.signal_map import SignalMap
from frasa_sysid.readers.sources import Unit, check_source
from frasa_sysid.recording import Fault, Recording

METADATA = "metadata.yaml"
HEADS: Mapping[str, bytes] = {".db3": b"SQLite format 3", ".bag": b"#ROSBAG V", METADATA: b""}
INSTALL = "install it with: pip install 'frasa[formats]'"


def read_bag(path: Path, unit: Unit = "auto", mapping: SignalMap | None = None) -> list[Recording]:
    """The one recording of a bag.

    Args:
        path: a `.bag` or `.db3` file, or the `metadata.yaml` of a folder of them.
        unit: of joint angles; `deg` converts, `auto` refuses goals that can only be degrees.
        mapping: which topics are which signals; by default the message types say it.

    Raises:
        LogError: `rosbags` is not installed, no such bag, damaged, or nothing in it that frasa can use.
    """
    kind = _checked(path)
    # What is brought in is brought in whole.
    collected = Collected(windows=KeptWindows(Limit(None)))
    with _opened(path, kind) as reader:
        lost = _collect(reader, kind == ".bag", mapping, collected)
    if lost and not collected.series:
        raise LogError(f"{path}: {lost[0].message}")
    lost += _unmerged(path)
    last = recordings_of(path, collected, unit=unit, mapping=mapping)[-1]
    return [replace(last, name=bag_of(path).name, sha256=_digest(path), faults=(*last.faults, *lost))]


def bag_of(path: Path) -> Path:
    """The bag that a file stands for: of the metadata of a folder, the folder."""
    return path.resolve().parent if path.name == METADATA else path


def bags_in(folder: Path) -> list[Path]:
    """The bags of a folder, which may be one itself: files, and the metadata of folders."""
    if (folder / METADATA).is_file():
        return [folder / METADATA]
    files = [one for pattern in ("*.bag", "*.db3") for one in folder.glob(pattern) if one.is_file()]
    return sorted([*files, *folder.glob(f"*/{METADATA}")])


def companions(path: Path) -> list[Path]:
    """The files of a bag beside the one that stands for it."""
    if path.name != METADATA:
        return []
    return sorted(one for one in path.parent.iterdir() if one.is_file() and one.name != METADATA)


def _digest(path: Path) -> str:
    """SHA-256 of a bag's data: of its one file, or of the sums of its files."""
    files = [path] if path.name != METADATA else companions(path) or [path]
    sums = [sha256_of_file(file) for file in files]
    return sums[0] if len(sums) == 1 else sha256_of("".join(sums).encode())


def _checked(path: Path) -> str:
    """The kind of a bag, a key of `HEADS`."""
    check_source(path)
    kind = METADATA if path.name == METADATA else path.suffix
    if kind not in HEADS:
        raise LogError(f"{path}: expected a .bag or .db3 file, or a rosbag2 folder with its {METADATA}")
    with path.open("rb") as file:
        if not file.read(16).startswith(HEADS[kind]):
            raise LogError(f"{path} is no bag: it does not begin with {HEADS[kind].decode()!r}")
    if kind == METADATA:
        read_yaml(path, LogError)  # nothing else than plain data is let through to the package
    for base in [path] if kind == ".db3" else sorted(path.parent.glob("*.db3")) if kind == METADATA else []:
        check_tables(base)
    return kind


@contextmanager
def _opened(path: Path, kind: str) -> Iterator[Any]:
    try:
        from rosbags import rosbag1, rosbag2
    except ImportError:
        raise LogError(f"{path}: ROS bags need the package rosbags; {INSTALL}") from None
    bind()
    reader = rosbag1.Reader(path) if kind == ".bag" else rosbag2.Reader(bag_of(path))
    try:
        reader.open()
    except Exception as error:  # a damaged file: SQLite, YAML and struct errors come as they are
        hint = "; 'rosbag reindex' mends one that was not closed" if "index" in str(error).lower() else ""
        raise LogError(f"{path} cannot be read as a bag: {_one_line(error)}{hint}") from error
    try:
        yield reader
    finally:
        with suppress(Exception):  # what is in the file, as above; all that is to be had has been read
            reader.close()


def _collect(reader: Any, ros1: bool, mapping: SignalMap | None, collected: Collected) -> list[Fault]:  # noqa: ANN401
    """Decode the topics that are of use; what was lost of a file that is damaged further on."""
    decoders: dict[tuple[str, str], Decode] = {}
    ros2 = DecoderFactory()
    wanted = []
    for i, one in enumerate(reader.connections):
        decode = _decoder(one, ros1, mapping, collected, ros2, i + 1)
        if decode is not None:
            decoders[one.topic, one.msgtype] = decode
            wanted.append(one)
    if not wanted:
        collected.report.messages = reader.message_count  # none of them of use: which there are is said
        return []
    try:
        for one, stamp, data in reader.messages(connections=wanted):
            collected.report.messages += 1
            take(collected, one.topic, decoders[one.topic, one.msgtype], data, stamp, stamp)
    except Exception as error:  # see _opened
        count = collected.report.messages
        text = f"the bag is damaged after {count} messages, which were recovered: {_one_line(error)}"
        return [Fault("truncated", count, text)]
    return []


def _decoder(
    connection: Any,  # noqa: ANN401 - of rosbags
    ros1: bool,
    mapping: SignalMap | None,
    collected: Collected,
    ros2: DecoderFactory,
    number: int,
) -> Decode | None:
    topic, kind = connection.topic, connection.msgtype
    if not isinstance(topic, str) or not isinstance(kind, str):  # SQLite keeps any type in any column
        collected.skipped["a topic whose name or type is no text"] += 1
        return None
    extract = extract_ros(kind) if mapping is None else extractor_of(mapping, topic)
    if extract is None:
        collected.unused.add(f"{topic} ({kind})")
        return None
    try:
        with redirect_stderr(StringIO()):  # a parser prints what it then raises
            unpack = _unpack_ros1(connection) if ros1 else _unpack_ros2(connection, ros2, number)
    except Exception:  # the parser runs on a definition from the file: anything may come out
        collected.skipped[f"{topic} ({kind}: its definition cannot be parsed)"] += 1
        return None
    if unpack is None:
        collected.skipped[
            f"{topic} ({kind}: the bag holds no definition of it; 'ros2 bag convert' to mcap adds it)"
        ] += 1
        return None
    return _joined(extract, unpack, topic)


def _joined(extract: Extract, unpack: Unpack, topic: str) -> Decode:
    return lambda data: extract(unpack(data), topic)


def _unpack_ros1(connection: Any) -> Unpack:  # noqa: ANN401
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.EMPTY)
    types = get_types_from_msg(connection.msgdef.data, connection.msgtype)
    check_definitions(types)
    store.register(types)
    return lambda data: store.deserialize_ros1(data, connection.msgtype)


def _unpack_ros2(connection: Any, ros2: DecoderFactory, number: int) -> Unpack | None:  # noqa: ANN401
    text = _definition(connection)
    if text is None:
        return None
    schema = Schema(number, text.encode(), "ros2msg", connection.msgtype)
    unpack: Unpack | None = ros2.decoder_for("cdr", schema)
    return unpack


def _definition(connection: Any) -> str | None:  # noqa: ANN401
    """The message definition with those that it uses, as text: the bag's own, ours, or that of ROS 2 Humble."""
    from rosbags.interfaces import MessageDefinitionFormat
    from rosbags.typesys import Stores, get_typestore

    if connection.msgdef.format == MessageDefinitionFormat.MSG and connection.msgdef.data:
        return str(connection.msgdef.data)
    known = {**LEGACY, **DEFINITIONS}.get(connection.msgtype)
    if known is not None:
        return known
    store = get_typestore(Stores.ROS2_HUMBLE)
    if connection.msgtype not in store.fielddefs:
        return None
    return str(store.generate_msgdef(connection.msgtype, ros_version=2)[0])


def _unmerged(path: Path) -> list[Fault]:
    """SQLite's journal beside a bag whose recorder crashed: what it holds is not read."""
    journals = [one for one in sorted(bag_of(path).parent.glob(f"{path.name}-wal")) if one.stat().st_size]
    text = "stands beside the bag: its last messages were not read; open the bag once with the sqlite3 tool to merge it"
    return [Fault("truncated", 1, f"{one.name} {text}") for one in journals]


def _one_line(error: BaseException) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]
