"""Damage to an input: any bytes, tokens of a text, values of a tree; by what kind of file it is.

Everything is drawn from one `random.Random`, so that a campaign's input is known by its seed and number.
"""

import gzip
import io
import json
import random
import zipfile
import zlib
from collections.abc import Callable, Sequence
from dataclasses import replace

from fuzzing.bytes_damage import damage_bytes
from fuzzing.case import Case
from fuzzing.text_damage import damage_text
from fuzzing.tree_damage import damage_tree

Damage = Callable[[bytes, random.Random], bytes]
TEXTS = (".json", ".jsonl", ".csv", ".txt", ".dat", ".toml", ".yaml", ".xml", ".log")


def mutate(case: Case, others: Sequence[Case], rng: random.Random) -> Case:
    """A damaged copy: one file of it, in one to four ways; now and then a whole file is lost or another one's.

    Args:
        case: a good input.
        others: inputs of the same format, to cut pieces from.
        rng: all chance.
    """
    name = rng.choice(sorted(case.files))
    content = case.files[name]
    if content is None:
        return case
    roll = rng.random()
    files: dict[str, bytes | None] = dict(case.files)
    if roll < 0.01:
        files[name] = None
        return replace(case, files=files, note="folder for a file")
    if roll < 0.02:
        files[name] = b""
        return replace(case, files=files, note="empty")
    if roll < 0.03 and len(files) > 1:
        del files[name]
        return replace(case, files=files, note="a file is missing")
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        content = _damaged(content, name, rng)
    if rng.random() < 0.05 and others:
        other = rng.choice(others)
        piece = next((one for one in other.files.values() if one), b"")
        cut = rng.randrange(len(content) + 1)
        content = content[:cut] + piece[rng.randrange(len(piece) + 1) :]
    files[name] = content
    return replace(case, files=files, note="damaged")


def _damaged(content: bytes, name: str, rng: random.Random) -> bytes:
    if content[:2] == b"\x1f\x8b" and rng.random() < 0.8:
        try:
            inner = gzip.decompress(content)
        except (OSError, EOFError, zlib.error):
            return damage_bytes(content, rng)
        return gzip.compress(_damaged(inner, name.removesuffix(".gz"), rng), 1, mtime=0)
    if content[:2] == b"PK" and rng.random() < 0.8:
        return _zip(content, rng)
    if name.endswith(".safetensors") and rng.random() < 0.7:
        return _safetensors(content, rng)
    if name.endswith(TEXTS) and rng.random() < 0.85:
        if name.endswith((".json", ".jsonl", ".yaml")) and rng.random() < 0.6:
            damaged = damage_tree(content, name, rng)
            if damaged is not None:
                return damaged
        damaged = damage_text(content, rng)
        return gzip.compress(damaged, 1, mtime=0) if rng.random() < 0.03 else damaged
    return damage_bytes(content, rng)


def _zip(content: bytes, rng: random.Random) -> bytes:
    """A member damaged and packed again, so that sums hold."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = {one.filename: archive.read(one) for one in archive.infolist()}
    except (zipfile.BadZipFile, NotImplementedError, zlib.error, EOFError, RuntimeError, OSError, ValueError):
        return damage_bytes(content, rng)
    if not members:
        return damage_bytes(content, rng)
    name = rng.choice(sorted(members))
    if rng.random() < 0.05:
        del members[name]
    else:
        inner = members[name]
        # What a header says is more telling than a number among thousands.
        head = rng.random() < 0.6
        members[name] = (damage_bytes(inner[:160], rng) + inner[160:]) if head else _damaged(inner, name, rng)
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))) as archive:
        for name, inner in members.items():
            archive.writestr(name, inner)
    return packed.getvalue()


def _safetensors(content: bytes, rng: random.Random) -> bytes:
    size = int.from_bytes(content[:8], "little")
    header = content[8 : 8 + size]
    try:
        json.loads(header)
    except ValueError:
        return damage_bytes(content, rng)
    damaged = damage_tree(header, "a.json", rng) or header
    return len(damaged).to_bytes(8, "little") + damaged + content[8 + size :]
