"""Servos to hold against bench logs: the nominal one, those of models, fits and BAM files; what each makes of a log.

All are brought to one supply and firmware gain, those of the bench, and simulated by the equations of the fit.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from frasa_sysid import bam_parameters, stored_fit
from frasa_sysid.bench import Bench
from frasa_sysid.bench_session import BenchSession
from frasa_sysid.calibration import SERVO_FIELDS, CalibrationError, calibration_id, load_model, number, read
from frasa_sysid.calibration.friction import FIELDS as FRICTION_FIELDS
from frasa_sysid.calibration.friction import Friction
from frasa_sysid.calibration.servo_law import law
from frasa_sysid.cost import Misfit, misfit
from frasa_sysid.errors import ModelError, UsageError
from frasa_sysid.fit import FitResult
from frasa_sysid.made_from import fit_of, fits_behind
from frasa_sysid.recording import FloatArray
from frasa_sysid.report_figures import Trace
from frasa_sysid.rig import BenchRun
from frasa_sysid.servo_values import FIELDS, NO_LIMIT, ServoValues

_RIG_OFFSET = "offset["  # `bench.offset[1.2kg 0.15m]`: zero of one rig beside the one that all share


@dataclass(frozen=True)
class BenchContender:
    """A servo that is held against logs.

    Attributes:
        name: for tables.
        values: what is simulated, at the bench's supply and firmware gain.
        file: where the numbers are from.
        zeros: of single rigs, beside that of all [rad].
        note: what a model could not be given of its bench, and why; empty where nothing is missing.
    """

    name: str
    values: ServoValues
    file: str = ""
    zeros: Mapping[str, float] = field(default_factory=dict)
    note: str = ""


@dataclass(frozen=True)
class BenchComparison:
    """Logs as they were measured, and as contenders have them.

    Attributes:
        runs: measured.
        readings: by contender: simulated angle [rad] at each run's times, an array for each run.
    """

    runs: tuple[BenchRun, ...]
    readings: Mapping[str, Sequence[FloatArray]]

    @property
    def errors(self) -> dict[str, Misfit]:
        """Of each contender, by name."""
        return {name: misfit(self.runs, found) for name, found in self.readings.items()}

    @property
    def traces(self) -> list[Trace]:
        """Every run with what each contender makes of it."""
        rows = zip(self.runs, *self.readings.values(), strict=True)
        return [Trace(run, dict(zip(self.readings, found, strict=True))) for run, *found in rows]


def compare_bench(
    contenders: Sequence[BenchContender], bench: Bench, session: BenchSession | None = None
) -> BenchComparison:
    """Simulate contenders over all runs of a bench, held out or not, from goals and starts alone.

    Args:
        contenders: each with a name of its own.
        bench: the logs.
        session: simulates; by default one made for it.

    Raises:
        LogError: a log that lacks a signal or fact.
    """
    if session is None:
        with bench.session() as own:
            return compare_bench(contenders, bench, own)
    train, held_out = bench.runs(session)
    runs = (*train, *held_out)
    kernel = session.kernel(runs)
    rows = kernel.readings(np.array([one.values.array() for one in contenders]), _offsets(contenders, runs))
    return BenchComparison(runs, {one.name: kernel.split(row) for one, row in zip(contenders, rows, strict=True)})


def of_nominal(bench: Bench, name: str = "nominal") -> BenchContender:
    """The servo before any fit."""
    return BenchContender(name, ServoValues(**bench.nominal), bench.model.name)


def of_result(name: str, result: FitResult) -> BenchContender:
    """The servo that a fit just found, with its law, its effects, and the zero of each rig."""
    pairs = zip(result.problem.free, result.values, strict=True)
    zeros = {one.rig: float(value) for one, value in pairs if one.rig}
    return BenchContender(name, result.problem.servo_values(result.values), "a fit", zeros)


def of_model(name: str, path: Path, bench: Bench, fits: Sequence[Path] = ()) -> BenchContender:
    """What a model of the robot does on the bench, with its friction law where it carries one.

    Zero offsets and unpowered damping have no place in such a model; they are those of the fit that it was published
    from, where that is at hand, else nominal. Effects stay off, as in the check of what was published.

    Args:
        name: for tables.
        path: of the model.
        bench: the logs.
        fits: where its fit may be, beside the folder `fits` where it lies.

    Raises:
        ModelError: no model, or one that does not say at which supply and gain its numbers hold.
    """
    model = load_model(path)
    fields = {**bench.nominal, **{one: read(model, f"{bench.servo.name}.{one}") for one in SERVO_FIELDS}}
    zeros: Mapping[str, float] = {}
    lender, why = _lender(path, calibration_id(model), bench.servo.name, fits)
    if lender is not None:
        fitted = of_fit(name, lender, bench)
        fields |= {"offset": fitted.values.offset, "damping_off": fitted.values.damping_off}
        zeros = fitted.zeros
    friction = law(model, bench.servo.name)
    kept = "zero of the encoder is" if friction else "zero of the encoder and damping with torque off are"
    note = f"{path}: {kept} nominal, for {why}" if why else ""
    if friction is not None:
        fields |= _law_fields(friction)
    stated = number(model, "servo_supply_voltage"), number(model, "servo_firmware_gain")
    return BenchContender(name, _restated(ServoValues(**fields), *stated, bench, path), _file(path), zeros, note)


def _lender(path: Path, key: str | None, servo: str, fits: Sequence[Path]) -> tuple[Path | None, str]:
    """The fit of a servo that a model was published from, or none, and why it is missing where it should be there."""
    if key is None:
        return None, ""
    beside = path.parent / "fits"
    try:
        digest = fits_behind(path, key).get(servo)
        if digest is None:  # published from fits of other servos
            return None, ""
        found = fit_of(digest, (*sorted(beside.glob("*.json")), *fits))
        why = f"its fit {digest[:12]} is neither in {beside} nor given with --fit"
    except CalibrationError as error:
        found, why = None, str(error)
    return found, "" if found else why


def of_fit(name: str, path: Path, bench: Bench) -> BenchContender:
    """The numbers of a fit file, those of its law and effects included.

    Raises:
        InputError: no fit file, or a wrong field.
        UsageError: of another servo.
    """
    stored = stored_fit.load(path)
    if stored.servo != bench.servo.name:
        raise UsageError(f"{path} is a fit of {stored.servo}, the logs are of {bench.servo.name}")
    # A rig's own text may hold dots: only the first one parts owner and field.
    numbers = {one.partition(".")[2]: float(content["value"]) for one, content in stored.parameters.items()}
    fields = {**bench.nominal, **{one: value for one, value in numbers.items() if one in FIELDS}}
    # Beside a sag, kp and torque limit are those of the unloaded supply.
    fields["rest"] = float("sag" in numbers)
    if stored.law is not None:
        # The law holds all coefficients, those too that only follow another one (M3, M4).
        fields |= _law_fields(stored.law)
    zeros = {
        one.removeprefix(_RIG_OFFSET).removesuffix("]"): value
        for one, value in numbers.items()
        if one.startswith(_RIG_OFFSET)
    }
    stated = stored.stated["supply_voltage"], stored.stated["firmware_gain"]
    return BenchContender(name, _restated(ServoValues(**fields), *stated, bench, path), _file(path), zeros)


def of_bam(name: str, path: Path, bench: Bench) -> BenchContender:
    """The servo of a BAM parameter file at the bench's supply and gain; commands act at once, as in BAM.

    Raises:
        InputError: no such file, or a wrong field.
        UsageError: of another servo.
    """
    found = bam_parameters.read(path, bench.servo)
    if found.actuator != bam_parameters.ACTUATORS.get(bench.servo.name):
        raise UsageError(f"{path} is of {found.actuator}, the logs are of {bench.servo.name}")
    one = found.servo
    values = ServoValues(
        kp=one.kp(),
        forcerange=one.force_limit(),
        damping=one.damping(),
        armature=one.armature,
        delay=0.0,
        offset=found.offset,
        goal_speed=NO_LIMIT if found.goal_speed is None else found.goal_speed,
        **_law_fields(one.friction),
    )
    return BenchContender(name, values, _file(path))


def _file(path: Path) -> str:
    """A file as it was given; of an absolute path the name, for a page is no map of a machine."""
    return path.name if path.is_absolute() else str(path)


def _law_fields(friction: Friction) -> dict[str, float]:
    shared = {name: float(getattr(friction, name)) for name in FRICTION_FIELDS if name != "coulomb"}
    return {**shared, "damping_off": friction.viscous, "frictionloss": friction.coulomb}


def _restated(values: ServoValues, supply: float, gain: float, bench: Bench, path: Path) -> ServoValues:
    """Gain and torque limit, stated at some supply and firmware gain, at those of the bench."""
    if not (supply > 0.0 and gain > 0.0):
        raise ModelError(f"{path}: states its gain at {supply:g} V and firmware gain {gain:g}; both must be above 0")
    volts, gains = bench.servo.supply_voltage / supply, bench.servo.firmware_gain / gain
    return replace(values, kp=values.kp * volts * gains, forcerange=values.forcerange * volts)


def _offsets(contenders: Sequence[BenchContender], runs: Sequence[BenchRun]) -> FloatArray:
    """Zero of every run's rig beside the contender's own [rad], (contenders, runs); 0 for a rig it does not know."""
    return np.array([[one.zeros.get(run.rig, 0.0) for run in runs] for one in contenders])
