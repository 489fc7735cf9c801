"""Files of runs and sweeps that were made to do harm, each found by `bench_fuzz.py`."""

import pytest

from frasa_rl.sweep_files import SWEEP_FILE, read_sweep
from frasa_rl.tables import EVALUATIONS
from frasa_sysid.calibration import InputError


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (b"a\nx\n", "is no table of numbers"),
        (b"\xff\n1\n", "is no table of numbers"),
        (b"a\n" + b"1" * 200_000, "is no table of numbers"),
        (b"a,b\n1\n1,2,3\n", "a row has not the 7 numbers"),
    ],
)
def test_tables_of_a_run(tmp_path, content, complaint):
    """Texts, other characters, endless fields, other numbers of columns."""
    assert EVALUATIONS.read(tmp_path) == []
    (tmp_path / EVALUATIONS.file).write_bytes(content)
    with pytest.raises(InputError, match=complaint):
        EVALUATIONS.read(tmp_path)


@pytest.mark.parametrize("content", [b"[" * 200_000, b"\xff", b"{}", b'{"schema": "frasa.sweep/1", "seeds": 5}'])
def test_a_sweep_that_is_none(tmp_path, content):
    """Lists within lists, and whatever else is no sweep."""
    (tmp_path / SWEEP_FILE).write_bytes(content)
    with pytest.raises(InputError):
        read_sweep(tmp_path)
