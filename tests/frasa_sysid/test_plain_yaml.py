"""YAML of strangers, wherever it is read: plain data or one line of error, at once."""

import pytest

from frasa_sysid.calibration import CalibrationError, InputError, read_calibration, read_yaml

LAUGHS = "a: &a [x, x]\n" + "".join(f"{b}: &{b} [*{a}, *{a}]\n" for a, b in zip("abcdefgh", "bcdefghi", strict=True))


def put(tmp_path, content):
    path = tmp_path / "a.yaml"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def test_plain_data_comes_as_it_is(tmp_path):
    """Numbers, texts, flags, lists, mappings, nothing; many of them too."""
    text = "a: 1\nb: [1.5, x, true, null]\nc: {d: '2'}\ne: 0x10\n" + "".join(f"k{i}: {i}\n" for i in range(2000))
    found = read_yaml(put(tmp_path, text), InputError)
    assert found["b"] == [1.5, "x", True, None]
    assert (found["c"], found["e"], found["k1999"]) == ({"d": "2"}, 16, 1999)


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (LAUGHS, "holds an alias"),
        ("&a [*a]", "holds an alias"),
        ("[" * 5000, "levels of lists and mappings"),
        ("{a: " * 5000, "levels of lists and mappings"),
        ("a: 1\na: 2", "stands twice"),
        ("? [1]\n: 2", "stands twice"),
        ("!!python/object/apply:os.system ['true']", "could not determine a constructor"),
        ("a: 0x" + "f" * 5000, "a number of 5002 digits"),
        ("a: " + "9:" * 3000 + "9", "a number of 6001 digits"),
        ("a: 2020-99-99", "month must be in"),
        ("a: 1\n---\nb: 2", "single document"),
        (b"\xff\xfe", "can't decode"),
        (b"a: '" + b"x" * 2**20 + b"'", "larger than 1 MiB"),
    ],
)
def test_what_is_not_plain_is_one_line(tmp_path, content, complaint):
    """Aliases, tags, depth, keys that stand twice, numbers of thousands of digits, characters, size."""
    with pytest.raises(CalibrationError, match=complaint) as found:
        read_yaml(put(tmp_path, content), CalibrationError)
    assert str(found.value).isprintable()


def test_no_plain_file(tmp_path):
    """A folder is an error of the kind asked for; a missing file is left to who knows what to do about it."""
    with pytest.raises(CalibrationError, match="is a folder"):
        read_calibration(tmp_path)
    with pytest.raises(FileNotFoundError):
        read_yaml(tmp_path / "none", InputError)
