"""A few seconds of the campaign of `benchmarks/bench_fuzz.py`: every quick reader reads damaged input or refuses it."""

import random
import sys
from functools import cache
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

sys.path.insert(0, str(Path(__file__).resolve().parent / "benchmarks"))

from fuzzing.case import put
from fuzzing.mutate import mutate
from fuzzing.targets import targets

from frasa_sysid.calibration import FrasaError

QUICK = (
    "mcap ros2", "mcap json", "mcap msgpack", "mcap protobuf", "mcap by a map", "bam", "dynaban", "csv", "npz", "jandi",
    "miuzei", "emps", "imu_on_axis", "robstride", "kbot", "harold", "upkie", "rostopic_csv", "map", "rig table",
    "excitation", "model (MJCF)", "fit", "fit checkpoint", "BAM parameters", "task (YAML)",
    "keyframes (YAML)", "deployed policy", "run's tables", "sweep",
)  # fmt: skip


@cache
def parts(form):
    target = targets()[form]
    # The calibrated model's friction law is compiled, which takes longer than all the rest.
    return [case for case in target.seeds() if case.entry != "calibrated.xml"], target.reader()


def refusal(read, path):
    """The error of the family that a reader refuses with, or None; any other error fails."""
    try:
        read(path)
    except FrasaError as error:
        return error
    return None


@pytest.mark.parametrize("form", QUICK)
def test_good_input_is_read(form, tmp_path):
    """What is damaged below is good before; a campaign over what nobody can read would find nothing."""
    seeds, read = parts(form)
    for case in seeds:
        read(put(case, tmp_path / "in"))


@pytest.mark.parametrize("form", QUICK)
@settings(max_examples=20, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(number=st.integers(0, 2**32))
def test_damaged_input_is_read_or_refused(form, tmp_path, number):
    """Whatever is damaged: a reading, or an error of the family for bad input in one line; any other error fails."""
    seeds, read = parts(form)
    rng = random.Random(f"{form} {number}")
    path = put(mutate(rng.choice(seeds), seeds, rng), tmp_path / "in")
    error = refusal(read, path)
    assert error is None or (error.exit_code == 3 and str(error).isprintable() and len(str(error)) > 10)
