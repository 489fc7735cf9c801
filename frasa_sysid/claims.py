"""Which fit says what in a published model: bench fits, and at most one of the whole robot that may stand on them.

Where both speak of a parameter, the robot's number holds if its fit stood on that bench fit (its sha256 is
among `frozen`): it is then the bench's number, scaled or found anew. Otherwise two fits claim one parameter.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from frasa_sysid.calibration import LAW_FIELDS, read
from frasa_sysid.calibration.friction import Friction
from frasa_sysid.calibration.parameters import LAW_COEFFICIENTS, SERVO_FIELDS
from frasa_sysid.calibration.stepping import TRAPEZOIDAL
from frasa_sysid.errors import CalibrationError
from frasa_sysid.model_mark import mark_of
from frasa_sysid.robot_numbers import made, makes
from frasa_sysid.stored_fit import StoredFit, model_parameters
from frasa_sysid.stored_robot_fit import StoredRobotFit, speaks_of

_SCALED = 1e-6  # relative difference allowed between a number and what made it


@dataclass(frozen=True)
class Instead:
    """A bench's number that the robot's fit replaced.

    Attributes:
        value: of the bench.
        low, high: the widest it tells of it.
        unit: of it.
        sha256: of the bench fit.
    """

    value: float
    low: float
    high: float
    unit: str
    sha256: str


@dataclass(frozen=True)
class Claims:
    """Every number of a published model, from one fit each.

    Attributes:
        benches: the bench fits in order, each without what the robot's fit says instead; their laws hold the
            robot's coefficients.
        robot: the robot's fit; None where there is none.
        instead: what it replaced, by parameter name.
        kept: what it would have replaced, had its logs spoken of it; the bench's number stays.
    """

    benches: tuple[StoredFit, ...]
    robot: StoredRobotFit | None
    instead: dict[str, Instead]
    kept: tuple[str, ...] = ()

    def servos(self) -> dict[str, dict[str, float]]:
        """Numbers of every servo class by field, those of its law included."""
        found: dict[str, dict[str, float]] = {one.servo: {} for one in self.benches}
        for one in self.benches:
            found[one.servo] |= {_field(name): float(p["value"]) for name, p in model_parameters(one).items()}
        for name, p in (self.robot.published if self.robot else {}).items():
            if _is_servo(name):
                found.setdefault(_owner(name), {})[_field(name)] = float(p["value"])
        return found

    def laws(self) -> dict[str, Friction]:
        """Friction laws beyond Coulomb-viscous, by servo class."""
        return {one.servo: law for one in self.benches if (law := one.model_law) is not None}

    @property
    def trapezoidal(self) -> bool:
        """Whether a model with these numbers has to step damping and friction to second order."""
        return any(one.stepping == TRAPEZOIDAL for one in self.benches)

    def robot_values(self) -> dict[str, float]:
        """What the robot's fit says, by parameter name."""
        return {name: float(one["value"]) for name, one in (self.robot.published if self.robot else {}).items()}

    def body_values(self) -> dict[str, float]:
        """The part of it that is no servo's: delays of sensors, zeros of joints, the trunk."""
        return {name: value for name, value in self.robot_values().items() if not _is_servo(name)}


def settle(fits: Sequence[StoredFit], robot: StoredRobotFit | None) -> Claims:
    """Decide which fit says what.

    Raises:
        CalibrationError: two fits claim one parameter, or the robot's fit does not go with the others.
    """
    benches = tuple(sorted(fits, key=lambda one: (one.servo, one.sha256)))
    owners: dict[str, StoredFit] = {}
    for stored in benches:
        for name in model_parameters(stored):
            if name in owners:
                raise CalibrationError(f"two fits claim {name}: {owners[name].sha256[:12]} and {stored.sha256[:12]}")
            owners[name] = stored
    if len({one.stepping for one in benches}) > 1:
        each = ", ".join(f"{one.servo} {one.stepping}" for one in benches)
        raise CalibrationError(f"the fits were made on benches that step differently ({each}); fit the older one again")
    if not owners and robot is None:
        raise CalibrationError("the fits hold no parameter of a model")
    if robot is None:
        return Claims(benches, None, {})
    _check_frozen(benches, robot)
    _check_laws(benches, robot)
    _check_standing(owners, robot)
    kept = tuple(name for name, one in robot.published.items() if name in owners and not speaks_of(one))
    told = replace(robot, parameters={name: one for name, one in robot.parameters.items() if name not in kept})
    instead = {name: _instead(owners[name], name) for name in told.published if name in owners}
    return Claims(tuple(_rest(one, told, instead) for one in benches), told, instead, kept)


def check_model(claims: Claims, model: mujoco.MjModel) -> None:
    """See that the robot's fit was made with this model, and that its numbers are what was free makes of others.

    Args:
        claims: with or without a robot's fit.
        model: the nominal one.

    Raises:
        CalibrationError: it was not.
        ModelError: a servo class, joint or trunk that the model does not have.
    """
    if claims.robot is None:
        return
    here, there = mark_of(model), claims.robot.model
    if here.fingerprint != there.fingerprint:
        raise CalibrationError(
            f"the robot fit {claims.robot.sha256[:12]} was made with another model: '{there.name}' "
            f"({there.fingerprint}), this is '{here.name}' ({here.fingerprint}); fit again from this model"
        )
    base = {name: read(model, name) for name in claims.robot_values() if _field(name) not in LAW_FIELDS}
    base |= {name: one.value for name, one in claims.instead.items()}
    for free, one in claims.robot.parameters.items():
        for name in makes(free, claims.robot.published):
            value, expected = claims.robot_values()[name], made(free, float(one["value"]), base[name])
            if not np.isclose(value, expected, rtol=_SCALED, atol=1e-12):
                raise CalibrationError(
                    f"{name} = {value:.6g}, but {free} = {one['value']:.6g} makes {expected:.6g} of the "
                    f"{base[name]:.6g} it stands on"
                )


def short_delays(claims: Claims, timestep: float) -> list[str]:
    """Delays that MuJoCo cannot act on, in words: below a physics step [s], it acts on a whole one."""
    return [
        f"{name} = {value * 1e3:.3g} ms: MuJoCo acts on it as on {timestep * 1e3:g} ms"
        for name, value in claims.robot_values().items()
        if _field(name).endswith("delay") and 0.0 < value < timestep
    ]


def _check_frozen(benches: Sequence[StoredFit], robot: StoredRobotFit) -> None:
    missing = sorted(set(robot.frozen) - {one.sha256 for one in benches})
    if missing:
        raise CalibrationError(
            f"the robot fit {robot.sha256[:12]} stood on the bench fit {missing[0][:12]}, which is not among those "
            "given; give it too, or fit the robot again"
        )


def _check_laws(benches: Sequence[StoredFit], robot: StoredRobotFit) -> None:
    """What the robot's fit says of friction must have a law, and the one it was found with."""
    by_servo = {one.servo: one for one in benches}
    for name in robot.published:
        bench = by_servo.get(_owner(name))
        known = {} if bench is None else model_parameters(bench)
        if _field(name) in LAW_FIELDS and name not in known:
            raise CalibrationError(f"the robot fit {robot.sha256[:12]} claims {name}, which no bench fit given has")
        if bench is not None and bench.stands_for and _is_servo(name) and _field(name) != "delay":
            raise CalibrationError(
                f"the robot fit {robot.sha256[:12]} claims {name}, found with friction law {bench.stands_for}; it "
                "cannot be published with its stand-in as m1"
            )


def _check_standing(owners: dict[str, StoredFit], robot: StoredRobotFit) -> None:
    for name in robot.published:
        bench = owners.get(name)
        if bench is not None and bench.sha256 not in robot.frozen:
            raise CalibrationError(
                f"two fits claim {name}: {bench.sha256[:12]} and {robot.sha256[:12]}; the robot's fit did not stand "
                "on the other, so fit the robot again"
            )


def _instead(bench: StoredFit, name: str) -> Instead:
    one = bench.parameters[name]
    low, high = min(one["low"], one["spread_low"]), max(one["high"], one["spread_high"])
    return Instead(float(one["value"]), float(low), float(high), one["unit"], bench.sha256)


def _rest(stored: StoredFit, robot: StoredRobotFit, instead: dict[str, Instead]) -> StoredFit:
    """A bench fit without what was replaced; its law has the new coefficients."""
    gone = {name for name in instead if _owner(name) == stored.servo}
    index = [i for i, name in enumerate(stored.correlated) if name not in gone]
    law = stored.law
    if law is not None:
        told = {name: float(robot.parameters[name]["value"]) for name in sorted(gone)}
        fields = {_field(name): value for name, value in told.items() if _field(name) in LAW_COEFFICIENTS}
        law = law.changed({LAW_COEFFICIENTS[field]: value for field, value in fields.items()})
    return replace(
        stored,
        parameters={name: one for name, one in stored.parameters.items() if name not in gone},
        correlated=tuple(stored.correlated[i] for i in index),
        correlation=stored.correlation[np.ix_(index, index)],
        law=law,
    )


def _owner(name: str) -> str:
    return name.rpartition(".")[0]


def _field(name: str) -> str:
    return name.rpartition(".")[2]


def _is_servo(name: str) -> bool:
    return _owner(name) not in ("sensor", "trunk", "") and _field(name) in SERVO_FIELDS | LAW_FIELDS
