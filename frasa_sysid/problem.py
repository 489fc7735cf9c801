"""What is fitted: which numbers are free, between which bounds, on which runs, held out by which rule."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from frasa_sysid.calibration import calibration_id, load_model, number, read, servo_classes
from frasa_sysid.errors import LogError, ModelError, UsageError
from frasa_sysid.recording import FloatArray, Recording
from frasa_sysid.rig import BenchRun
from frasa_sysid.rollout import ServoValues
from frasa_sysid.servo import Servo, servo

# Bounds as multiples of the nominal value: wide enough for another unit, supply or gear ratio
# of the same type, narrow enough that the search starts in the right world.
_SPAN = {
    "kp": (0.2, 4.0),
    "forcerange": (0.2, 3.0),
    "damping": (0.05, 4.0),
    "damping_off": (0.0, 20.0),
    "frictionloss": (0.0, 6.0),
    "armature": (0.05, 4.0),
}
_UNIT = {
    "kp": "N m/rad",
    "forcerange": "N m",
    "damping": "N m s/rad",
    "damping_off": "N m s/rad",
    "frictionloss": "N m",
    "armature": "kg m^2",
    "delay": "s",
    "offset": "rad",
}
_LONGEST_OFFSET = 0.15  # [rad]


@dataclass(frozen=True)
class FreeParameter:
    """One number the fit may move.

    Attributes:
        name: `mx106.damping` or `bench.offset`.
        unit: SI unit as text.
        low, high: bounds.
        nominal: where it starts and what it is compared with.
    """

    name: str
    unit: str
    low: float
    high: float
    nominal: float

    @property
    def field(self) -> str:
        """The last part of the name."""
        return self.name.rpartition(".")[2]


@dataclass(frozen=True)
class FitProblem:
    """A fit, fully stated; the same problem and seed give the same result.

    Attributes:
        servo: firmware constants, supply and gain at which kp is stated.
        nominal: value of every field before the fit.
        free: the numbers the search moves, n of them.
        train, held_out: runs.
        hold_out_rule: as given on the command line.
        seed: of the search.
    """

    servo: Servo
    nominal: Mapping[str, float]
    free: tuple[FreeParameter, ...]
    train: tuple[BenchRun, ...]
    held_out: tuple[BenchRun, ...]
    hold_out_rule: str
    seed: int

    def from_unit(self, x: FloatArray) -> FloatArray:
        """Parameter values from a point of the unit cube, both of shape (n,)."""
        low, high = self._bounds()
        return low + np.clip(x, 0.0, 1.0) * (high - low)

    def to_unit(self, values: FloatArray) -> FloatArray:
        """Point of the unit cube of parameter values, both of shape (n,)."""
        low, high = self._bounds()
        return (values - low) / (high - low)

    def servo_values(self, values: FloatArray) -> ServoValues:
        """What is simulated for values of the free parameters, shape (n,)."""
        fields = dict(self.nominal)
        fields.update({one.field: float(value) for one, value in zip(self.free, values, strict=True)})
        return ServoValues(**fields)

    def nominal_values(self) -> FloatArray:
        """Nominal value of every free parameter, shape (n,)."""
        return np.array([one.nominal for one in self.free])

    def _bounds(self) -> tuple[FloatArray, FloatArray]:
        return np.array([one.low for one in self.free]), np.array([one.high for one in self.free])


def stated_servo(name: str, model_path: Path) -> tuple[Servo, dict[str, float]]:
    """A servo and the nominal value of each field, from the robot's model where it has that servo.

    Args:
        name: servo type.
        model_path: the nominal robot model.

    Returns:
        The servo, and `ServoValues` fields in MuJoCo's terms at the servo's stated supply and gain.

    Raises:
        UsageError: nobody knows the servo.
        ModelError: there is no such model, it is calibrated already, or a number in it is not positive.
    """
    known = servo(name)
    fields = {
        "kp": known.kp(),
        "forcerange": known.force_limit(),
        "damping": known.damping(),
        "frictionloss": known.friction.coulomb,
        "armature": known.armature,
        "delay": 0.0,
    }
    model = load_model(model_path)
    if calibration_id(model) is not None:
        raise ModelError(f"{model_path} is calibrated already; a fit starts from the nominal model")
    if name in servo_classes(model):
        supply, gain = number(model, "servo_supply_voltage"), number(model, "servo_firmware_gain")
        known = replace(known, supply_voltage=supply, firmware_gain=gain)
        fields = {field: read(model, f"{name}.{field}") for field in fields}
        flat = [field for field in _SPAN if field in fields and not fields[field] > 0.0]
        if flat:
            raise ModelError(f"{model_path}: {', '.join(flat)} of '{name}' must be above 0 to start a fit from")
    return known, {**fields, "damping_off": known.friction.viscous, "offset": 0.0}


def free_parameters(
    known: Servo, nominal: Mapping[str, float], runs: Sequence[BenchRun], delay_range: tuple[float, float]
) -> tuple[FreeParameter, ...]:
    """The numbers that logs of this kind can speak of, with physical bounds.

    Args:
        known: the servo.
        nominal: value by field.
        runs: a force limit or an offset means nothing to voltage-driven runs, a switched-off
            damping nothing to runs that are always powered.
        delay_range: shortest and longest that the model tells apart [s].
    """
    voltage = all(run.voltage_driven for run in runs)
    switched = any(run.switches.size or not run.powered_first for run in runs)
    fields = ["kp", "damping", "frictionloss", "armature", "delay"]
    fields += [] if voltage else ["forcerange", "offset"]
    fields += ["damping_off"] if switched else []
    return tuple(_free(known.name, field, nominal[field], delay_range) for field in fields)


def split(recordings: Sequence[Recording], rule: str) -> tuple[list[Recording], list[Recording]]:
    """Training and held-out recordings.

    Args:
        recordings: all of them.
        rule: `none`; `kp=24`, `mass=0.969`, `length=0.1`, `trajectory=sin_sin`; or `kp`, `rig`,
            `trajectory`, which hold out the largest gain, the rig with the largest moment and the
            last trajectory in alphabetical order.

    Raises:
        UsageError: an unknown rule, or one that leaves nothing on either side.
    """
    if rule == "none":
        return list(recordings), []
    key, _, wanted = rule.partition("=")
    facts = [_fact(one, key) for one in recordings]
    known = sorted({fact for fact in facts if fact is not None}, key=lambda fact: (str(type(fact)), fact))
    chosen = _parse(wanted, known, rule) if wanted else (known[-1] if known else None)
    held = [one for one, fact in zip(recordings, facts, strict=True) if fact == chosen]
    train = [one for one, fact in zip(recordings, facts, strict=True) if fact != chosen]
    if not held or not train:
        raise UsageError(
            f"--hold-out {rule} leaves {len(train)} runs to fit and {len(held)} to hold out; the logs have {key} = "
            + (", ".join(str(fact) for fact in known) or "nothing")
        )
    return train, held


def _fact(recording: Recording, key: str) -> float | str | None:
    rig = recording.rig
    if key == "kp":
        return rig.firmware_gain
    if key == "rig":
        return round((rig.mass or 0.0) * (rig.length or 0.0), 6)
    if key in ("mass", "length"):
        fact: float | None = getattr(rig, key)
        return fact
    if key == "trajectory":
        return rig.trajectory
    raise UsageError(f"--hold-out {key}: expected none, kp, rig, mass, length or trajectory, each also as KEY=VALUE")


def _parse(wanted: str, known: Sequence[float | str], rule: str) -> float | str:
    """The known fact a word means: the very text, or the nearest number within 1e-3."""
    if wanted in known:
        return wanted
    try:
        number = float(wanted)
    except ValueError:
        raise UsageError(f"--hold-out {rule}: the logs have {', '.join(str(fact) for fact in known)}") from None
    near = [fact for fact in known if isinstance(fact, float) and abs(fact - number) < 1e-3]
    return near[0] if near else number


def _free(owner: str, field: str, nominal: float, delay_range: tuple[float, float]) -> FreeParameter:
    if field == "offset":
        return FreeParameter("bench.offset", "rad", -_LONGEST_OFFSET, _LONGEST_OFFSET, nominal)
    if field == "delay":
        return FreeParameter(f"{owner}.delay", "s", *delay_range, nominal)
    low, high = _SPAN[field]
    return FreeParameter(f"{owner}.{field}", _UNIT[field], low * nominal, high * nominal, nominal)


def servo_name(recordings: Sequence[Recording], given: str | None) -> str:
    """The servo all recordings are of.

    Raises:
        LogError: nobody says, or they differ.
    """
    names = {one.rig.servo for one in recordings if one.rig.servo} if given is None else {given}
    if len(names) != 1:
        found = ", ".join(sorted(names)) or "none"
        raise LogError(f"the logs must be of one servo type, found: {found}; give --servo NAME")
    return names.pop()
