"""Which numbers of a robot are free, between which bounds, and how vaguely they are known beforehand.

A weak prior (normal, around what is there before the fit) keeps what the log does not speak of where it
is; a number whose interval is hardly narrower than its prior's is called not excited, so that the prior
is never taken for a measurement.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from frasa_sysid.errors import UsageError
from frasa_sysid.recording import FloatArray
from frasa_sysid.robot_candidate import Candidate
from frasa_sysid.robot_numbers import COMMAND_DELAY
from frasa_sysid.robot_rig import RobotRun

GROUPS = ("delays", "zeros", "gain", "damping", "friction", "trunk")
DEFAULT_GROUPS = GROUPS[:-1]
AXES = ("x", "y", "z")


@dataclass(frozen=True)
class Kind:
    """What numbers of one kind have in common.

    Attributes:
        unit: SI unit as text.
        low, high: bounds.
        prior: standard deviation of what is known beforehand.
        step: for derivatives: far wider than the roughness that sticking joints give the cost. Slopes over what a
            log can tell led fits astray by 5 ms.
        fine: half-width of an interval up to which the number counts as identified.
        trust: standard deviation of what the model itself gets wrong about it, whatever the log says: its
            step, the firmware's sampling, the law. Other numbers follow along.
    """

    unit: str
    low: float
    high: float
    prior: float
    step: float
    fine: float
    trust: float = 0.0


DELAY = Kind("s", 0.0, 0.12, 0.03, 3e-3, 1e-3, 2.5e-4)
ZERO = Kind("rad", -0.2, 0.2, 0.03, 0.02, 3.5e-3)
# A joint at rest agrees with its log wherever friction holds it, and disagrees as soon as it slips: a fit prefers
# zeros at which nothing slips to those that are true.
ZERO_STANDING = Kind("rad", -0.2, 0.2, 0.03, 0.02, 3.5e-3, 4e-3)
# With a trunk that may be a tenth too heavy, knees that hang lower than they should are taken for zeros of hip, knee
# and ankle that add up to nothing.
ZERO_LOADED = Kind("rad", -0.2, 0.2, 0.03, 0.02, 3.5e-3, 0.015)
SCALE = Kind("1", 0.3, 3.0, 0.4, 0.12, 0.05, 0.006)
# For the same reason friction comes out a few percent too high where a robot stands.
FRICTION_STANDING = Kind("1", 0.3, 3.0, 0.4, 0.12, 0.05, 0.02)
MASS_SCALE = Kind("1", 0.5, 2.0, 0.2, 0.1, 0.03)
SHIFT = Kind("m", -0.05, 0.05, 0.02, 0.01, 3e-3)


@dataclass(frozen=True)
class FreeNumber:
    """One number that the fit may move.

    Attributes:
        name: `command.delay`, `sensor.gyro_delay`, `left_knee.zero`, `mx106.gain_scale`, `trunk.mass_scale`, ...
        kind: bounds, prior, unit.
        start: where it starts; the prior's centre.
    """

    name: str
    kind: Kind
    start: float


@dataclass(frozen=True)
class RobotProblem:
    """A whole-robot fit, fully stated.

    Attributes:
        runs: recordings to fit.
        free: n numbers.
        ages: of channels that are declared, by name [s]; that of positions always is.
        trunk_mass: before the fit [kg].
        seed: kept with the result.
        command_delays: of servo classes, where that of commands is not free [s].
    """

    runs: tuple[RobotRun, ...]
    free: tuple[FreeNumber, ...]
    ages: dict[str, float]
    trunk_mass: float
    seed: int = 0
    command_delays: Mapping[str, float] = field(default_factory=dict)

    def start(self) -> FloatArray:
        """Where the fit starts, (n,)."""
        return np.array([one.start for one in self.free])

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Lowest and highest values, (n,) each."""
        return np.array([one.kind.low for one in self.free]), np.array([one.kind.high for one in self.free])

    def candidate(self, x: FloatArray) -> Candidate:
        """The robot that values of the free numbers, (n,), mean."""
        found: dict[str, dict[str, float]] = {"zero": {}, "gain_scale": {}, "damping_scale": {}, "friction_scale": {}}
        ages, shift = dict(self.ages), [0.0, 0.0, 0.0]
        one = Candidate(command_delays=self.command_delays)
        for free, value in zip(self.free, map(float, x), strict=True):
            owner, _, what = free.name.partition(".")
            if free.name == COMMAND_DELAY:
                one = replace(one, command_delay=value)
            elif owner == "sensor":
                ages[what.removesuffix("_delay")] = value
            elif what == "mass_scale":
                one = replace(one, trunk_mass=value * self.trunk_mass)
            elif what.startswith("com_shift"):
                shift[AXES.index(what[-1])] = value
            else:
                found[what][owner] = value
        return replace(
            one,
            ages=ages,
            zeros=found["zero"],
            gain=found["gain_scale"],
            damping=found["damping_scale"],
            friction=found["friction_scale"],
            trunk_shift=(shift[0], shift[1], shift[2]),
        )


def default_groups(bases: Iterable[str | None]) -> tuple[str, ...]:
    """What is free when nobody says: on the ground the trunk too, since zeros stand or fall with its weight.

    Args:
        bases: of the logs.
    """
    return GROUPS if "floating" in bases else DEFAULT_GROUPS


def state_robot_problem(
    runs: Sequence[RobotRun],
    servos: Sequence[str],
    delays: dict[str, float],
    trunk_mass: float,
    groups: Sequence[str] | None = None,
    seed: int = 0,
    command_delays: Mapping[str, float] | None = None,
) -> RobotProblem:
    """A fit of some groups of numbers on some runs.

    Args:
        runs: of one robot.
        servos: its servo classes.
        delays: what the model has before the fit [s]: `command`, `position`, `velocity`, `gyro`, `orientation`.
        trunk_mass: [kg].
        groups: names out of `GROUPS`; by default `default_groups`.
        seed: for the record.
        command_delays: of servo classes [s], which hold where the delays are not free.

    Raises:
        UsageError: an unknown group.
    """
    groups = default_groups(run.base for run in runs) if groups is None else groups
    unknown = sorted(set(groups) - set(GROUPS))
    if unknown:
        raise UsageError(f"--free {', '.join(unknown)}: expected {', '.join(GROUPS)}")
    free: list[FreeNumber] = []
    if "delays" in groups:
        free.append(FreeNumber(COMMAND_DELAY, DELAY, delays["command"]))
        free += [FreeNumber(f"sensor.{name}_delay", DELAY, delays[name]) for name in _moving_channels(runs)]
    standing = any(run.base == "floating" for run in runs)
    if "zeros" in groups:
        kind = ZERO if not standing else ZERO_STANDING if "trunk" in groups else ZERO_LOADED
        free += [FreeNumber(f"{joint}.zero", kind, 0.0) for joint in runs[0].joints]
    for group in ("gain", "damping", "friction"):
        if group in groups:
            scale = FRICTION_STANDING if standing and group == "friction" else SCALE
            free += [FreeNumber(f"{servo}.{group}_scale", scale, 1.0) for servo in servos]
    if "trunk" in groups:
        free.append(FreeNumber("trunk.mass_scale", MASS_SCALE, 1.0))
        free += [FreeNumber(f"trunk.com_shift_{axis}", SHIFT, 0.0) for axis in AXES]
    declared = {name: delays[name] for name in ("position", "velocity", "gyro", "orientation")}
    kept = {} if "delays" in groups else dict(command_delays or {})
    return RobotProblem(tuple(runs), tuple(free), declared, trunk_mass, seed, kept)


def _moving_channels(runs: Sequence[RobotRun]) -> list[str]:
    """Channels whose age these logs can show; a trunk that is held says nothing of its IMU's."""
    on_ground = [run for run in runs if run.base == "floating"]
    found = ["velocity"] if any("velocity" in run.channels for run in runs) else []
    return found + [name for name in ("gyro", "orientation") if any(name in run.channels for run in on_ground)]
