"""The readers of the fitter: logs, maps, models, fits, checkpoints of fits, excitations."""

import json
from contextlib import suppress
from functools import cache, partial
from pathlib import Path

import numpy as np

from fuzzing import seeds_messages, seeds_texts
from fuzzing.case import Case, case_in, single
from fuzzing.targets import Read, Target, losses

ROOT = Path(__file__).resolve().parents[3]
MODELS = ROOT / "robot_model"


def _log(form: str, mapping: str | None = None) -> Read:
    """The reader of `frasa-sysid import --format`."""
    from frasa_sysid.commands.import_formats import READERS
    from frasa_sysid.readers.signal_map import load_map, parse_map

    chosen = parse_map("m", seeds_texts.MAP, False) if form in ("csv", "npz", "parquet") else None
    chosen = load_map(mapping) if mapping else chosen
    return lambda path: losses(READERS[form](path, "auto", chosen))


def _mcap() -> Read:
    from frasa_sysid.readers import read_log

    return lambda path: losses(read_log(path))


def _map() -> Read:
    """A map, and what it says of columns and topics."""
    from frasa_sysid.readers.signal_map import load_map

    def read(path: Path) -> int:
        found = load_map(str(path))
        for one in found.entries:
            one.match("/joint_states"), one.match("q_knee")
        return 0

    return read


def _model() -> Read:
    from frasa_sysid.calibration import load_model
    from frasa_sysid.model_xml import inlined, parts_of

    def read(path: Path) -> int:
        load_model(path)
        inlined(path), parts_of(path)
        return 0

    return read


def _ranges() -> Read:
    from frasa_sysid.calibration.load import read_calibration

    def read(path: Path) -> int:
        read_calibration(path).sample(np.random.default_rng(0))
        return 0

    return read


def _fit() -> Read:
    from frasa_sysid.commands.publish import load_fits

    def read(path: Path) -> int:
        load_fits([path])
        return 0

    return read


def _bam_parameters() -> Read:
    from frasa_sysid.bam_parameters import read as read_parameters

    def read(path: Path) -> int:
        read_parameters(path)
        return 0

    return read


def _fit_checkpoint() -> Read:
    """A damaged one costs time only: it is left aside, and what is taken of it fits the search."""
    from frasa_sysid.calibration.errors import OutputError
    from frasa_sysid.commands.fit_robot import _resumed
    from frasa_sysid.search import search

    def read(path: Path) -> int:
        place = _resumed(path, "ab")
        if place is not None and not np.isfinite([*place.x, *(place.units or ())]).all():
            raise ValueError(f"a start of {place}")
        with suppress(OutputError):  # a folder where the checkpoint goes
            search(lambda points: [float(np.sum(one**2)) for one in points], np.full(2, 0.5), 0, 30, path, "ab")
        return 0

    return read


def _rig_table() -> Read:
    from frasa_sysid.rig_table import read_rig_table

    def read(path: Path) -> int:
        return len(read_rig_table(path)) * 0

    return read


def _servo() -> Read:
    from frasa_sysid.servo import find_table

    def read(path: Path) -> int:
        find_table(str(path))
        return 0

    return read


def _excitation() -> Read:
    from frasa_sysid.excitation_file import read_excitation

    def read(path: Path) -> int:
        read_excitation(path)
        return 0

    return read


def _models() -> list[Case]:
    small = {name: (MODELS / name).read_bytes() for name in ("bench_pendulum.xml", "servos_nominal.xml")}
    names = ("calibrated.xml", "sigmaban.xml", "measurements_nominal.xml", "floor.xml")
    whole = {name: (MODELS / name).read_bytes() for name in names}
    other = case_in(MODELS / "small_humanoid", "small_humanoid.xml")
    return [Case(small, "bench_pendulum.xml"), other, Case(whole, "calibrated.xml")]


def _fits() -> list[Case]:
    fits = [single(one.read_bytes(), "fit.json") for one in sorted((MODELS / "fits").glob("*.json"))]
    number = {"value": 0.004, "low": 0.003, "high": 0.005, "nominal": 0.0, "unit": "s", "verdict": "identified"}
    robot = {
        "schema": "frasa.fit/2", "kind": "robot", "servo": "", "base": "fixed",
        "parameters": {
            "sensor.gyro_delay": number,
            "left_knee.zero": {**number, "unit": "rad"},
            "trunk.mass": {**number, "value": 3.4, "low": 3.3, "high": 3.5, "unit": "kg"},
        },
        "correlation": {"names": ["sensor.gyro_delay", "left_knee.zero"], "matrix": [[1.0, 0.1], [0.1, 1.0]]},
        "model": {"name": "sigmaban", "fingerprint": "ab" * 8},
        "stated_at": {"supply_voltage": 15.0, "firmware_gain": 12.0}, "frozen": ["0" * 64],
        "inputs": {"a.mcap": "0" * 64}, "origin": "simulated", "not_in_model": ["x"],
        "from_logs": {"supply_voltage": [13.0, 16.0], "delay_jitter": [-0.001, 0.001]},
        "spread": {"trunk.mass": [3.2, 3.6]}, "bootstrap": {},
    }  # fmt: skip
    return [*fits, single(json.dumps(robot).encode(), "fit.json", "robot")]


def _checkpoints() -> list[Case]:
    searched = {"searches": {"ab": [[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]] * 3, "cd": [[1.0] * 5]}}
    place = {
        "stage": "all", "x": [0.1, 0.2, 0.3], "units": [1.0, 2.0], "iteration": 3, "used": 40, "cost": 1.5,
        "weighing": False, "converged": False, "moves": [[0, 3], [1, 2]],
    }  # fmt: skip
    partial_ = {"identity": "ab", "place": place}
    return [single(json.dumps(one).encode(), "partial.json") for one in (searched, partial_)]


def _excitations() -> list[Case]:
    return [one for one in seeds_messages.written() if one.note == "robot"]


def _bam_files() -> list[Case]:
    base = {
        "model": "m4", "actuator": "mx106", "kt": 2.1, "R": 2.3, "armature": 0.02, "q_offset": 0.01,
        "friction_viscous": 0.05, "friction_base": 0.05, "friction_stribeck": 0.05, "dtheta_stribeck": 0.2,
        "alpha": 1.2, "load_friction_base": 0.02, "load_friction_stribeck": 0.04,
    }  # fmt: skip
    other = {**base, "model": "m6", "actuator": "sts3215", "error_gain_ratio": 0.9, "max_velocity": 5.0}
    more = ("load_friction_motor", "load_friction_external", "load_friction_motor_stribeck")
    more += ("load_friction_external_stribeck", "load_friction_motor_quad", "load_friction_external_quad")
    other.update(dict.fromkeys(more, 0.01))
    return [single(json.dumps(one).encode(), "m.json") for one in (base, other)]


@cache
def _texts() -> dict[str, list[Case]]:
    return seeds_texts.texts()


@cache
def _bags() -> dict[str, list[Case]]:
    return seeds_messages.bags()


def _rig_tables() -> list[Case]:
    return [single(b"mass,length,total_inertia,total_g_bias\n0.5,0.15,0.02,-0.7\n1.0,0.15,0.04,-1.4\n", "rigs.csv")]


_FORMATS = ("bam", "dynaban", "csv", "parquet", "npz", "jandi", "miuzei", "emps", "imu_on_axis", "robstride", "kbot")
_FORMATS += ("harold", "upkie", "rostopic_csv")
TARGETS: dict[str, Target] = {
    "mcap ros2": Target(seeds_messages.ros2, _mcap, 3.0),
    "mcap json": Target(seeds_messages.as_json, _mcap),
    "mcap msgpack": Target(seeds_messages.as_msgpack, _mcap),
    "mcap protobuf": Target(seeds_messages.as_protobuf, _mcap),
    "mcap by a map": Target(seeds_messages.as_json, partial(_log, "mcap", "robocup")),
    **{form: Target(lambda form=form: _texts()[form], partial(_log, form)) for form in _FORMATS},  # type: ignore[misc]
    "map": Target(lambda: _texts()["map"], _map),
    "rosbag .bag": Target(lambda: _bags()["bag"], partial(_log, "rosbag")),
    "rosbag .db3": Target(lambda: _bags()["db3"], partial(_log, "rosbag")),
    "rosbag folder": Target(lambda: _bags()["bag_folder"], partial(_log, "rosbag")),
    "rig table": Target(_rig_tables, _rig_table, 0.5),
    "servo table": Target(
        lambda: [single(one.read_bytes(), "a.toml") for one in sorted((ROOT / "frasa_sysid/servos").glob("*.toml"))],
        _servo,
    ),
    "excitation": Target(_excitations, _excitation, 0.5),
    "model (MJCF)": Target(_models, _model, 2.0),
    "ranges (YAML)": Target(
        lambda: [single((MODELS / "randomization.yaml").read_bytes(), "randomization.yaml")], _ranges, 0.5
    ),
    "fit": Target(_fits, _fit),
    "fit checkpoint": Target(_checkpoints, _fit_checkpoint, 0.5),
    "BAM parameters": Target(_bam_files, _bam_parameters, 0.5),
}
