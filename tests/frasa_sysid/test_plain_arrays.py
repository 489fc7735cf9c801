"""NumPy's files of strangers: what NumPy writes is read to the bit, what only looks like it is refused before memory is
taken, and nothing is unpickled."""

import io
import os
import pickle
import zipfile

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from frasa_sysid.calibration.plain_arrays import array_sizes, read_arrays

GOOD = {
    "x": np.arange(5.0), "text": np.array("abc"), "none": np.zeros((0, 3)), "one": np.array(3, dtype=np.int64),
    "order": np.asfortranarray(np.arange(6).reshape(2, 3)), "flags": np.array([True, False]),
    "big": np.arange(3, dtype=">f4"), "dates": np.array(["2020-01-01"], dtype="M8[ns]"),
    "cube": np.zeros((1, 2, 3), np.float32),
}  # fmt: skip


class Executes:
    def __reduce__(self):
        return os.mkdir, ("executed",)


def packed(content, name="x.npy"):
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(name, content)
    return file.getvalue()


def npy(shape, data=bytes(8), descr="<f8"):
    header = f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + data


def objects():
    file = io.BytesIO()
    np.save(file, np.array([Executes()], dtype=object), allow_pickle=True)
    return file.getvalue()


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_what_numpy_writes_is_read(tmp_path, save):
    """Kind, shape, order of bytes and every value."""
    save(tmp_path / "a.npz", **GOOD)
    found = read_arrays(tmp_path / "a.npz", 10**6)
    assert found.keys() == GOOD.keys()
    for name, array in GOOD.items():
        assert (found[name].dtype, found[name].shape) == (array.dtype, array.shape)
        np.testing.assert_array_equal(found[name], array)
    assert list(read_arrays(tmp_path / "a.npz", 10**6, ["x"])) == ["x"]


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (packed(npy("(1000000000000000000,)")), "8 bytes for float64"),
        (packed(npy("(400000000,)")), "8 bytes for float64"),
        (packed(npy("(-1,)")), "nothing is unpickled"),
        (packed(npy("(1,)", descr="|O")), "nothing is unpickled"),
        (packed(npy("(1,)", descr="<v8")), "'<v8' is no type of numbers"),
        (packed(objects()), "nothing is unpickled"),
        (packed(pickle.dumps(Executes())), "nothing is unpickled"),
        (packed(npy("__import__('os').mkdir('executed')")), "nothing is unpickled"),
        (packed(npy("(1,)"), "y.npy"), "no array x"),
        (packed(npy("(200000,)", bytes(1_600_000))), "unpack to 1600"),
        (pickle.dumps(Executes()), "not a zip file"),
        (b"", "not a zip file"),
    ],
)
def test_what_only_looks_like_arrays(tmp_path, monkeypatch, content, complaint):
    """Claims that the bytes do not bear out, objects, pickles, code, bombs: one error, and nothing happens."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.npz").write_bytes(content)
    with pytest.raises(ValueError, match=complaint):
        read_arrays(tmp_path / "a.npz", 10**6, ["x"])
    assert not (tmp_path / "executed").exists()


@settings(max_examples=300, deadline=None)
@given(st.data())
def test_any_damage(tmp_path_factory, data):
    """Whatever bytes are changed or cut: arrays of plain numbers, or ValueError."""
    path = tmp_path_factory.getbasetemp() / "damaged.npz"
    np.savez(path, **GOOD)
    content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(bytes(content[: data.draw(st.integers(0, len(content)))] or content))
    try:
        array_sizes(path)
        found = read_arrays(path, 10**6)
    except ValueError:
        return
    assert all(one.dtype.kind in "fiubUM" for one in found.values())


@pytest.mark.parametrize("packing", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_what_numpy_does_not_pack_with_is_refused(tmp_path, packing):
    """Other ways to pack raise errors of their own for damage."""
    path = tmp_path / "a.npz"
    content = io.BytesIO()
    np.save(content, np.arange(3.0))
    with zipfile.ZipFile(path, "w", packing) as archive:
        archive.writestr("x.npy", content.getvalue())
    with pytest.raises(ValueError, match="packed in another way than deflate"):
        read_arrays(path, 1000)
