"""Hostile tasks, policies, runs and checkpoints."""

import io
import json
import zipfile
from collections.abc import Callable

from fuzzing import bombs, targets_rl
from fuzzing.case import Case, single
from fuzzing.hostile_models import yaml_texts
from fuzzing.targets_sysid import MODELS


def _yaml(name: str, source: str) -> Callable[[], list[Case]]:
    # An empty task is the default task, so it may be read; what must be refused is refused elsewhere.
    return lambda: yaml_texts(name, (MODELS / source).read_bytes())


def _safetensors(header: bytes, data: bytes = b"", size: int | None = None) -> bytes:
    return (len(header) if size is None else size).to_bytes(8, "little") + header + data


def _weights(name: str) -> dict[str, bytes]:
    one = {"dtype": "F32", "shape": [2, 2], "data_offsets": [0, 16]}
    bias = {"dtype": "F32", "shape": [2], "data_offsets": [16, 24]}
    whole = {"layer0.weight": one, "layer0.bias": bias}
    big = {**one, "shape": [2**20, 2**20], "data_offsets": [0, 2**42]}
    return {
        "header of 2^63": _safetensors(b"{}", size=2**63),
        "header of 90 MB": _safetensors(b"{}" + b" " * 90_000_000),
        "nested": _safetensors(b"[" * 100_000),
        "claims 4 TB": _safetensors(json.dumps({**whole, "layer0.weight": big}).encode(), bytes(24)),
        "overlap": _safetensors(
            json.dumps({**whole, "layer0.bias": {**bias, "data_offsets": [0, 8]}}).encode(), bytes(16)
        ),
        "a pickle": bombs.pickled(),
        "empty": b"",
    }


def _policies() -> list[Case]:
    (good,) = targets_rl.TARGETS["run and policy"].seeds()
    found = [
        Case({**good.files, "policy/weights.safetensors": one}, "", f"weights {note}", True)
        for note, one in _weights("x").items()
    ]
    run = good.files["run.yaml"] or b""
    for case in yaml_texts("run.yaml", run):
        found.append(Case({**good.files, **case.files}, "", f"run {case.note}", case.refuse))
        inner = {f"policy/{name}": one for name, one in case.files.items()}
        found.append(Case({**good.files, **inner}, "", f"policy's run {case.note}", case.refuse))
    return found


def _deployed() -> list[Case]:
    (good,) = targets_rl.TARGETS["deployed policy"].seeds()
    odd = {"nested": b"[" * 100_000, "empty": b"", "not UTF-8": b"\xff\xfe", "huge number": b"9" * 10**6}
    found = [Case({**good.files, "deploy.json": one}, "", f"deploy {note}", True) for note, one in odd.items()]
    more = [
        Case({**good.files, "weights.safetensors": one}, "", f"weights {note}", True)
        for note, one in _weights("x").items()
    ]
    return [*found, *more, Case({**good.files, "deploy.json": None}, "", "a folder", True)]


def _checkpoints() -> list[Case]:
    (good,) = targets_rl.TARGETS["training checkpoint"].seeds()
    state = next(name for name in good.files if name.endswith("state.npz"))
    model = next(name for name in good.files if name.endswith("model.zip"))
    found = [
        Case({**good.files, state: one}, "", f"state {note}", True)
        for note, one in bombs.arrays_bombs("mark", {}).items()
    ]
    found += [Case({**good.files, model: one}, "", f"model {note}", True) for note, one in _models(good.files[model])]
    found.append(Case({state: good.files[state]}, "", "no model", True))
    found.append(Case({**good.files, state: None}, "", "state a folder", True))
    found.append(Case({"checkpoints": b""}, "", "no folder", True))
    found.append(Case({"checkpoints/00x/state.npz": b""}, "", "a folder of another name", True))
    return found


def _models(good: bytes | None) -> list[tuple[str, bytes]]:
    """SB3 files that hold pickles, bombs, or other things than tensors."""
    with zipfile.ZipFile(io.BytesIO(good or b"")) as archive:
        members = {one: archive.read(one) for one in archive.namelist()}
    pickles = {name: bombs.pickled() if name.endswith(".pth") else one for name, one in members.items()}
    return [
        ("empty", b""),
        ("a pickle", bombs.pickled()),
        ("pickles", bombs.packed(pickles)),
        ("zip bomb", bombs.zip_bomb("policy.pth", b"PK\x03\x04")),
        ("no tensors", bombs.packed({name: b"" for name in members})),
    ]


def _sb3() -> list[Case]:
    good = targets_rl.TARGETS["SB3 file"].seeds()[0].files["a.zip"]
    found = [single(one, "a.zip", note, refuse=True) for note, one in _models(good)]
    with zipfile.ZipFile(io.BytesIO(good or b"")) as archive:
        members = {one: archive.read(one) for one in archive.namelist()}
    data = {"nested": b"[" * 100_000, "huge": b"9" * 10**6, "list": b"[]", "not UTF-8": b"\xff"}
    found += [
        single(bombs.packed({**members, "data": one}), "a.zip", f"data {note}", True) for note, one in data.items()
    ]
    return [*found, Case({"a.zip": None}, "a.zip", "a folder", True)]


def _sweeps() -> list[Case]:
    (good,) = targets_rl.TARGETS["sweep"].seeds()
    name = next(iter(good.files))
    odd = {"nested": b"[" * 200_000, "not UTF-8": b"\xff", "seeds": b'{"schema": "frasa.sweep/1", "seeds": 5}'}
    return [Case({name: one}, "", note, True) for note, one in odd.items()] + [Case({name: None}, "", "a folder", True)]


def _tables() -> list[Case]:
    odd = {"text": b"a\nx\n", "not UTF-8": b"\xff\n1\n", "long": b"a\n" + b"1" * 200_000, "ragged": b"a,b\n1\n1,2,3\n"}
    return [Case({"progress.csv": one}, "", note) for note, one in odd.items()]


MADE: dict[str, Callable[[], list[Case]]] = {
    "task (YAML)": _yaml("task.yaml", "standup.yaml"),
    "keyframes (YAML)": _yaml("keyframes.yaml", "keyframes.yaml"),
    "run and policy": _policies,
    "deployed policy": _deployed,
    "training checkpoint": _checkpoints,
    "SB3 file": _sb3,
    "sweep": _sweeps,
    "run's tables": _tables,
}
