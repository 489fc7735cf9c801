"""Hostile texts and tables."""

import io
import json
from collections.abc import Callable

import numpy as np

from fuzzing import bombs, seeds_texts
from fuzzing.case import Case, single

NAMES = {
    "bam": "a.json", "miuzei": "a.json", "robstride": "real_a.json", "kbot": "kbot_a.json", "upkie": "a.jsonl",
    "harold": "a.csv", "rostopic_csv": "a.csv", "csv": "a.csv", "dynaban": "a.txt", "imu_on_axis": "a.dat",
}  # fmt: skip
HEADS = {
    "bam": b'{"entries": [', "miuzei": b'{"config": {"action_hz": 50}, "data": [', "kbot": b"[", "upkie": b"",
    "robstride": b'{"config": {}, "data": [', "harold": b"timestamp,timestamp_ms,pos_hip\n", "csv": b"t,q_knee\n",
    "rostopic_csv": b"%time,field.header.stamp\n", "dynaban": b"Time Command Position Speed\n", "imu_on_axis": b"",
}  # fmt: skip


def of_text(form: str) -> list[Case]:
    """What any text format may be given."""
    name = NAMES[form]
    made = {
        "empty": b"",
        "zeros": bytes(100_000),
        "not UTF-8": b"\xff\xfe\xfa" * 1000,
        "nested": b"[" * 200_000,
        "nested objects": b'{"a":' * 200_000,
        "one long line": b"1" * 5_000_000,
        "a pickle": bombs.pickled(),
        "gzip cut off": bombs.gzip_of(HEADS[form] * 100)[:-6],
        "gzip in gzip": bombs.gzip_of(bombs.gzip_of(b"x" * 10**6)),
        "gzip bomb": bombs.gzip_bomb(),
        "gzip bomb of lists": bombs.gzip_bomb(b"[],"),
        "gzip bomb of rows": bombs.gzip_bomb(b"12,34,\n1 2 3 4\n", 300),
        "head and bomb": bombs.many(HEADS[form], b"[],{},1.5,\n", 128),
        "many columns": b",".join(b"a%d" % i for i in range(200_000)) + b"\n",
    }
    return [single(content, name, note, refuse=True) for note, content in made.items()] + [
        Case({name: None}, name, "a folder", refuse=True)
    ]


def _sized(form: str) -> list[Case]:
    """Numbers that make the reader make large things."""
    bam = json.loads(next(iter(seeds_texts.texts()["bam"][0].files.values())) or b"")
    if form == "bam":
        odd = [("dt 1e-300", {"dt": 1e-300}), ("dt nan", {"dt": float("nan")}), ("extra", {"clocks": 5, "joint": [1]})]
        for entry in bam["entries"]:
            entry.pop("timestamp")
        return [single(json.dumps({**bam, **more}).encode(), "a.json", note) for note, more in odd]
    return []


def _column() -> bytes:
    file = io.BytesIO()
    np.save(file, np.arange(10.0))
    return file.getvalue()


def _npz() -> list[Case]:
    found = [
        single(one, "a.npz", note, refuse=True)
        for note, one in bombs.arrays_bombs("q_knee", {"t.npy": _column()}).items()
    ]
    file = io.BytesIO()
    np.savez(file, t=np.arange(9) / 9, q_knee=np.array(["1", "x"] * 4 + ["2"]), cmd_knee=np.zeros((9, 2, 2)))
    return [*found, single(file.getvalue(), "a.npz", "texts for numbers", refuse=True)]


def _map() -> list[Case]:
    stars = b"*" * 40
    long = b"a" * 200
    head = b'[[signal]]\ntopic = "%s"\nfield = "x"\nsignal = "position"\nunit = "rad"\n'
    return [
        single(head % (stars + b"x" + stars), "a.toml", "stars"),
        single(head % (b"*a" * 30), "a.toml", "stars and letters"),
        single(head.replace(b'"x"', b'"x[' + b"9" * 5000 + b']"') % long, "a.toml", "huge index"),
        single(b"a = " + b"[" * 100_000, "a.toml", "nested", refuse=True),
        single(b"a = 0x" + b"f" * 10**6, "a.toml", "a number of a million digits", refuse=True),
        single(b"a." * 100_000 + b"b = 1", "a.toml", "a long key", refuse=True),
        single(b"\n".join(b"a%d = 1" % i for i in range(400_000)), "a.toml", "400 000 keys", refuse=True),
        single(b"\xff\xfe", "a.toml", "not UTF-8", refuse=True),
        Case({"a.toml": None}, "a.toml", "a folder", refuse=True),
    ]


def _servo() -> list[Case]:
    return [
        single(b"a = " + b"[" * 100_000, "a.toml", "nested", refuse=True),
        single(b'schema = "frasa.servo/1"\nname = 0x' + b"f" * 6000, "a.toml", "a number of many digits", refuse=True),
        single(b"a." * 100_000 + b"b = 1", "a.toml", "a long key", refuse=True),
        single(b"\n".join(b"a%d = 1" % i for i in range(400_000)), "a.toml", "400 000 keys", refuse=True),
        single(b"\xff\xfe", "a.toml", "not UTF-8", refuse=True),
        Case({"a.toml": None}, "a.toml", "a folder", refuse=True),
    ]


def _matlab() -> list[Case]:
    import zlib

    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
    packer = zlib.compressobj(9)
    first = packer.flush(zlib.Z_FULL_FLUSH)
    block = packer.compress(bytes(2**26)) + packer.flush(zlib.Z_FULL_FLUSH)
    bomb = first + block * 48 + packer.flush()
    return [
        single(head, "a.mat", "a head alone", refuse=True),
        single(head + (15).to_bytes(4, "little") + len(bomb).to_bytes(4, "little") + bomb, "a.mat", "bomb", True),
        single(head + b"\x0e\x00\x00\x00\x08\x00\x00\x00" * 100_000, "a.mat", "empty arrays", refuse=True),
    ]


def _parquet() -> list[Case]:
    import pandas as pd

    wide = io.BytesIO()
    frame = pd.DataFrame({"t": np.zeros(10**7), "q_knee": np.zeros(10**7), "cmd_knee": np.zeros(10**7)})
    frame.to_parquet(wide, compression="zstd")
    return [
        single(wide.getvalue(), "a.parquet", "ten million equal rows"),
        single(b"PAR1" + b"\xff" * 40 + (2**31 - 1).to_bytes(4, "little") + b"PAR1", "a.parquet", "footer size", True),
    ]


def _json_files(name: str, *, nested: bool = True) -> list[Case]:
    made = {"empty": b"", "not UTF-8": b"\xff\xfe", "a pickle": bombs.pickled(), "huge number": b"9" * 10**6}
    made |= {"nested": b"[" * 200_000} if nested else {}
    return [single(one, name, note, refuse=True) for note, one in made.items()] + [
        Case({name: None}, name, "a folder", refuse=True)
    ]


def _text_maker(form: str) -> Callable[[], list[Case]]:
    return lambda: [*of_text(form), *_sized(form)]


def _checkpoint() -> list[Case]:
    return [
        Case(one.files, one.entry, one.note)
        for one in [
            *(one for one in _json_files("partial.json") if one.note != "a folder"),
            single(json.dumps({"identity": "ab", "x": [[1], 2]}).encode(), "partial.json", "ragged"),
            single(json.dumps({"identity": "ab", "x": 5}).encode(), "partial.json", "a number"),
            single(json.dumps({"identity": "ab", "x": [float("nan")]}).encode(), "partial.json", "nan"),
            single(json.dumps({"searches": {"ab": [[10**400]]}}).encode(), "partial.json", "a huge number"),
        ]
    ]


MADE: dict[str, Callable[[], list[Case]]] = {
    **{form: _text_maker(form) for form in NAMES},
    "npz": _npz,
    "map": _map,
    "servo table": _servo,
    "emps": _matlab,
    "parquet": _parquet,
    "fit": lambda: _json_files("fit.json"),
    "BAM parameters": lambda: _json_files("m.json"),
    "fit checkpoint": _checkpoint,
}
