"""Files of runs and sweeps that were made to do harm, each found by `bench_fuzz.py`."""

import zipfile

import numpy as np
import pytest

from frasa_rl.checkpoint import FOLDER, CheckpointError, load_checkpoint
from frasa_rl.keyframe_file import load_keyframes
from frasa_rl.routine import KeyframeError
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


def test_settings_in_a_file_are_input(tmp_path, robot_model_dir):
    """A number that cannot be is bad input (exit 3) where a run.yaml says it, not a mistake on the command line (2)."""
    pytest.importorskip("sb3_contrib")
    from frasa_rl.plan import plan_of

    good = (robot_model_dir / "policies" / "standup" / "run.yaml").read_text()
    assert plan_of(robot_model_dir / "policies" / "standup").settings.envs == 64
    for line, bad in (
        ("  envs: 64", "  envs: -1"),
        ("  envs: 64", "  envs: many"),
        ("settings:", "settings: 5\nother:"),
    ):
        assert line in good
        (tmp_path / "run.yaml").write_text(good.replace(line, bad))
        with pytest.raises(InputError, match=r"run\.yaml: ") as found:
            plan_of(tmp_path)
        assert found.value.exit_code == 3


def test_keyframes_with_a_number_that_no_float_holds(tmp_path, robot_model_dir):
    """Four hundred digits are one line of error."""
    good = (robot_model_dir / "keyframes.yaml").read_text()
    start = good.index("rise_s: ") + len("rise_s: ")
    path = tmp_path / "keyframes.yaml"
    path.write_text(good[:start] + "9" * 400 + good[good.index("\n", start) :])
    with pytest.raises(KeyframeError, match="a number of 400 digits, expected a smaller one"):
        load_keyframes(path)


@pytest.mark.parametrize(
    ("state", "packed", "complaint"),
    [
        ({"mark": np.array("m"), "x": np.arange(3)}, False, "it was loaded"),
        ({"mark": np.array("m"), "x": np.arange(3)}, True, "holds data packed"),
        ({"mark": np.array("other")}, False, "another model, task, or settings"),
        ({"x": np.arange(3)}, False, "mark"),
        ({"mark": np.array("m"), "x": np.array([{}], dtype=object)}, False, "nothing is unpickled"),
    ],
)
def test_checkpoints_are_plain_and_unpacked(tmp_path, state, packed, complaint):
    """Arrays of numbers, and SB3's file as SB3 writes it: what is packed could be of any size."""
    folder = tmp_path / FOLDER / "000000008"
    folder.mkdir(parents=True)
    np.savez(folder / "state.npz", **state)
    with zipfile.ZipFile(folder / "model.zip", "w", zipfile.ZIP_DEFLATED if packed else zipfile.ZIP_STORED) as archive:
        archive.writestr("data", bytes(1000))

    def load(path):
        raise ValueError("it was loaded")

    with pytest.raises(CheckpointError, match=complaint):
        load_checkpoint(tmp_path, "m", load, lambda arrays: None)


def test_a_packed_state_is_no_checkpoint(tmp_path):
    """A few kB that unpack to megabytes are not as the run wrote them."""
    folder = tmp_path / FOLDER / "000000008"
    folder.mkdir(parents=True)
    np.savez_compressed(folder / "state.npz", mark=np.array("m"), x=np.zeros(10**6))
    with pytest.raises(CheckpointError, match="its arrays unpack to 8000"):
        load_checkpoint(tmp_path, "m", lambda path: None, lambda arrays: None)
