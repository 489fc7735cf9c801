"""What is fitted: which numbers are free, between which bounds, on which runs, held out by which rule."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from frasa_sysid.calibration import calibration_id, load_model, number, read, servo_classes
from frasa_sysid.calibration.friction import FIELDS as FRICTION_FIELDS
from frasa_sysid.calibration.friction import check_law
from frasa_sysid.effects import AUTOMATIC, EFFECTS, law_numbers
from frasa_sysid.errors import ModelError, UsageError
from frasa_sysid.free_parameter import SPAN, UNIT, FreeParameter, free_number, rig_offsets
from frasa_sysid.recording import FloatArray
from frasa_sysid.rig import BenchRun
from frasa_sysid.servo import Servo, find_table
from frasa_sysid.servo_values import COLUMN, ServoValues


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
        law: friction law, `m1` to `m6`.
        effects: what else is switched on, names of `effects.EFFECTS`.
        ties: fields that equal another one.
        plain: `nominal` as it was before any law or effect added its numbers.
    """

    servo: Servo
    nominal: Mapping[str, float]
    free: tuple[FreeParameter, ...]
    train: tuple[BenchRun, ...]
    held_out: tuple[BenchRun, ...]
    hold_out_rule: str
    seed: int
    law: str = "m1"
    effects: tuple[str, ...] = ()
    ties: Mapping[str, str] = field(default_factory=dict)
    plain: Mapping[str, float] = field(default_factory=dict)

    def from_unit(self, x: FloatArray) -> FloatArray:
        """Parameter values from points of the unit cube, both of shape (..., n)."""
        low, high = self._bounds()
        return low + np.clip(x, 0.0, 1.0) * (high - low)

    def to_unit(self, values: FloatArray) -> FloatArray:
        """Points of the unit cube of parameter values, both of shape (..., n)."""
        low, high = self._bounds()
        return (values - low) / (high - low)

    def servo_values(self, values: FloatArray) -> ServoValues:
        """What is simulated for values of the free parameters, shape (n,); zero offsets of single rigs left out."""
        fields = dict(self.nominal)
        fields.update({one.field: float(value) for one, value in zip(self.free, values, strict=True) if not one.rig})
        fields.update({name: fields[leader] for name, leader in self.ties.items()})
        return ServoValues(**fields)

    def candidates(self, points: FloatArray) -> FloatArray:
        """Numbers for the kernel from points of the unit cube, (m, n) to (m, fields)."""
        values = self.from_unit(points)
        table = np.repeat(ServoValues(**self.nominal).array()[None], len(values), axis=0)
        for i, one in enumerate(self.free):
            if not one.rig:
                table[:, COLUMN[one.field]] = values[:, i]
        for name, leader in self.ties.items():
            table[:, COLUMN[name]] = table[:, COLUMN[leader]]
        return table

    def offsets(self, points: FloatArray, runs: Sequence[BenchRun]) -> FloatArray | None:
        """Zero offsets of single rigs [rad] for points of the unit cube, (m, n) to (m, runs); none without such."""
        if "offsets" not in self.effects:
            return None
        values = self.from_unit(points)
        found = np.zeros((len(values), len(runs)))
        for i, one in enumerate(self.free):
            if one.rig:
                found[:, [j for j, run in enumerate(runs) if run.rig == one.rig]] = values[:, i, None]
        return found

    def nominal_values(self) -> FloatArray:
        """Nominal value of every free parameter, shape (n,)."""
        return np.array([one.nominal for one in self.free])

    def start_values(self) -> FloatArray:
        """Where the search starts, shape (n,): nominal, except for numbers whose nominal value hides their effect."""
        return np.array([one.start for one in self.free])

    def _bounds(self) -> tuple[FloatArray, FloatArray]:
        return np.array([one.low for one in self.free]), np.array([one.high for one in self.free])


def stated_servo(name: str, model_path: Path, table: Servo | None = None) -> tuple[Servo, dict[str, float]]:
    """A servo and the nominal value of each field, from the robot's model where it has that servo.

    Args:
        name: servo type.
        model_path: the nominal robot model.
        table: of a user's own; by default that of the name beside the model, or that comes with frasa.

    Returns:
        The servo, and `ServoValues` fields in MuJoCo's terms at the servo's stated supply and gain.

    Raises:
        UsageError: nobody knows the servo.
        ModelError: there is no such model, it is calibrated already, or a number in it is not positive or outside
            the bounds of the servo's table.
    """
    known = find_table(name, model_path).servo if table is None else table
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
        flat = [field for field in SPAN if field in fields and not fields[field] > 0.0]
        if flat:
            raise ModelError(f"{model_path}: {', '.join(flat)} of '{name}' must be above 0 to start a fit from")
        _check_bounds(known, fields, model_path)
    law = {name: getattr(known.friction, name) for name in FRICTION_FIELDS if name != "coulomb"}
    return known, {**fields, **law, "damping_off": known.friction.viscous, "offset": 0.0}


def _check_bounds(known: Servo, fields: Mapping[str, float], model_path: Path) -> None:
    """The numbers of a model must be ones that the table allows."""
    for name, value in fields.items():
        span = known.span(name)
        if span is not None and not span[0] <= value <= span[1]:
            raise ModelError(
                f"{model_path}: {name} of '{known.name}' is {value:.4g} {UNIT[name]}, its servo table allows "
                f"{span[0]:.4g} to {span[1]:.4g}: one of the two is wrong"
            )


def state_problem(
    known: Servo,
    nominal: Mapping[str, float],
    train: Sequence[BenchRun],
    held_out: Sequence[BenchRun],
    delay_range: tuple[float, float],
    rule: str = "none",
    seed: int = 0,
    law: str = "m1",
    effects: Sequence[str] = (),
) -> FitProblem:
    """A fit of one friction law and a set of effects.

    Args:
        known: the servo.
        nominal: value of every field before the fit.
        train: runs; a force limit or an offset means nothing to voltage-driven ones, a
            switched-off damping nothing to those that are always powered.
        held_out: runs.
        delay_range: shortest and longest that the model tells apart [s].
        rule: hold-out rule, for the record.
        seed: of the search.
        law: `m1` to `m6`.
        effects: names of `effects.EFFECTS`.

    Raises:
        UsageError: an unknown law or effect.
    """
    numbers, ties = law_numbers(check_law(law))
    free = [free_number(known, field, nominal, delay_range) for field in _basic_fields(train)]
    top = max((_goal_speed(run) for run in train), default=0.0)
    for name in effects:
        if name not in EFFECTS:
            raise UsageError(f"unknown effect '{name}': known are {', '.join(EFFECTS)}")
        numbers += EFFECTS[name].numbers
    values = dict(nominal)
    for one in numbers:
        low, high, start = one.bounds(nominal["forcerange"], max(top, 1.0))
        owner = known.name if one.owner == "servo" else "bench"
        neutral = getattr(ServoValues(**nominal), one.field)
        # Speed and shape of a Stribeck term that is zero mean nothing; and "no speed limit" is outside any bounds.
        neutral = start if one.field.startswith("stribeck_") else min(max(neutral, low), high)
        values[one.field] = neutral
        free.append(FreeParameter(f"{owner}.{one.field}", one.unit, low, high, neutral, start))
    if "sag" in effects:
        values["rest"] = 1.0
    if "supply" in effects:
        values["follow"] = 1.0
    if "offsets" in effects:
        free += rig_offsets(train)
    return FitProblem(
        known, values, tuple(free), tuple(train), tuple(held_out), rule, seed, law, tuple(effects), ties, nominal
    )


def possible(runs: Sequence[BenchRun]) -> tuple[str, ...]:
    """Effects that these runs could show at all."""
    if any(run.absolute for run in runs):
        # No firmware at work, and no torque limit: what is left is the supply.
        return ("sag", "drag") if all(run.control == "voltage" for run in runs) else ()
    without = set()
    if all(np.all(run.supply == 1.0) for run in runs):
        without.add("supply")
    if len({run.rig for run in runs}) < 2:
        without.add("offsets")
    return tuple(name for name in AUTOMATIC if name not in without)


def several_loads(runs: Sequence[BenchRun]) -> bool:
    """Whether load-dependent friction can show: a load that changes, as gravity's does under way."""
    return any(run.gravity_torque > 0.0 for run in runs)


def _basic_fields(runs: Sequence[BenchRun]) -> list[str]:
    controls = {run.control for run in runs}
    fields = [] if controls == {"force"} else ["kp"]
    fields += ["damping", "frictionloss", "armature"]
    fields += [] if controls == {"force"} else ["delay"]
    fields += ["forcerange", "offset"] if "position" in controls else []
    return fields + (["damping_off"] if any(run.switches.size or not run.powered_first for run in runs) else [])


def _goal_speed(run: BenchRun) -> float:
    """Speed of the goal that is passed for at least a tenth of a second [rad/s]."""
    if run.absolute or run.t[-1] <= 0.0:
        return 0.0
    step = run.t[-1] / max(run.steps, 1)
    window = max(round(0.05 / step), 1)
    moved = np.abs(run.command[window:] - run.command[:-window])
    return float(moved.max(initial=0.0) / (window * step))
