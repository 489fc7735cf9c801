"""What a log becomes once read: signals on their own clocks, and the facts of the rig.

A `Recording` is one uninterrupted run. A file may hold many (a bench session with
several loads and gains), so every reader returns a list of them.

Names and units of the signals that frasa knows (others may be present and are kept):

======================  ========  =====================================================
`position`              rad       measured joint position
`velocity`              rad/s     measured joint velocity, as the servo reports it
`goal`                  rad       commanded joint position
`voltage_command`       V         commanded motor voltage (open-loop benches)
`torque_enable`         1         1 while the motor is powered, 0 while it is off
`supply_voltage`        V         supply voltage measured at the servo
`force`                 N         force of a linear drive, known from its calibration
`duty`                  1         signed share of the full PWM that the servo gives its motor
`current`, `load`, ...  as given  kept, never taken for torque without a declared unit
======================  ========  =====================================================

The zero of a bench position is the arm hanging straight down; gravity is
-`gravity_torque` * sin(position).

A linear axis has `position` and `goal` in m and `velocity` in m/s instead, all of them
or none; the bench fit and the rules of identification are about angles and leave it out.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from frasa_sysid.errors import LogError

FloatArray = npt.NDArray[np.float64]
Clock = Literal["header", "publish", "log", "file"]

UNITS: Mapping[str, str] = MappingProxyType(
    {
        "position": "rad",
        "velocity": "rad/s",
        "goal": "rad",
        "voltage_command": "V",
        "torque_enable": "1",
        "supply_voltage": "V",
        "force": "N",
        "duty": "1",
    }
)
LINEAR_UNITS: Mapping[str, str] = MappingProxyType(
    {"position": "m", "velocity": "m/s", "goal": "m", "goal_velocity": "m/s"}
)


@dataclass(frozen=True)
class Signal:
    """One measured or commanded quantity on its own clock.

    Attributes:
        name: see the table of this module.
        unit: SI unit as text; `raw` where the log does not say.
        t: sample times [s], strictly increasing, shape (T,); zero is the recording's start.
        y: values, shape (T,) for one channel or (T, k) for k joints.
        columns: names of the k channels (joints); empty for shape (T,).

    Raises:
        LogError: no sample, shapes that disagree, time that does not increase, or NaN.
    """

    name: str
    unit: str
    t: FloatArray
    y: FloatArray
    columns: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        t = np.array(self.t, dtype=np.float64)
        y = np.array(self.y, dtype=np.float64)
        if t.ndim != 1 or t.size == 0:
            raise LogError(f"signal '{self.name}' has no samples")
        if y.shape[:1] != t.shape or y.ndim > 2:
            raise LogError(f"signal '{self.name}': {t.size} times but values of shape {y.shape}")
        if (y.shape[1:] or (0,))[0] != len(self.columns):
            raise LogError(f"signal '{self.name}': values {y.shape} do not fit columns {self.columns}")
        if not (np.isfinite(t).all() and np.isfinite(y).all()):
            bad = int((~np.isfinite(t)).sum() + (~np.isfinite(y)).sum())
            raise LogError(f"signal '{self.name}' holds {bad} values that are not finite (NaN or infinity)")
        if (np.diff(t) <= 0).any():
            raise LogError(f"signal '{self.name}': time stands still or runs backwards")
        t.setflags(write=False)
        y.setflags(write=False)
        object.__setattr__(self, "t", t)
        object.__setattr__(self, "y", y)

    def __repr__(self) -> str:
        return f"Signal({self.name} [{self.unit}], {self.y.shape}, {self.t[0]:.3f}..{self.t[-1]:.3f} s)"


@dataclass(frozen=True)
class RigFacts:
    """What is known about the rig of one recording; None where nobody said.

    Attributes:
        servo: servo type in lower case, such as `mx106`.
        mass: load at the end of the arm [kg].
        length: axis to load [m].
        arm_mass: mass of the arm, taken as a uniform rod of `length` [kg].
        inertia: whole pendulum about the axis [kg m^2]; replaces what mass and length give.
        gravity_torque: torque that holds the arm horizontal [N m]; replaces likewise.
        firmware_gain: P gain of the servo's position loop, in the firmware's own unit.
        supply_voltage: declared supply [V]; the measured signal has precedence.
        control: `position` (goal angles), `voltage` (open loop), or `force` (a linear axis whose
            drive force is known; the loop around it, if there is one, need not be).
        trajectory: name of the excitation.
        base: of a robot: `fixed` while its trunk is hung or held, `floating` on the ground.
    """

    servo: str | None = None
    mass: float | None = None
    length: float | None = None
    arm_mass: float | None = None
    inertia: float | None = None
    gravity_torque: float | None = None
    firmware_gain: float | None = None
    supply_voltage: float | None = None
    control: Literal["position", "voltage", "force"] = "position"
    trajectory: str | None = None
    base: Literal["fixed", "floating"] | None = None

    def __post_init__(self) -> None:
        for name in ("mass", "length", "arm_mass", "inertia", "gravity_torque", "firmware_gain", "supply_voltage"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value >= 0):
                raise LogError(f"rig fact {name} = {value}: expected a finite number, zero or more")
        if self.control not in ("position", "voltage", "force"):
            raise LogError(f"rig fact control = '{self.control}': expected 'position', 'voltage' or 'force'")
        if self.base not in (None, "fixed", "floating"):
            raise LogError(f"rig fact base = '{self.base}': expected 'fixed' or 'floating'")

    def known(self) -> dict[str, Any]:
        """The facts that are known, by name."""
        return {f.name: getattr(self, f.name) for f in fields(self) if getattr(self, f.name) is not None}


@dataclass(frozen=True)
class Fault:
    """Something wrong with a log that was found and handled.

    Attributes:
        code: stable short name, such as `failed_read` or `truncated`.
        count: how many samples, messages or bytes it concerns.
        message: one sentence for people: what was found and what was done.
    """

    code: str
    count: int
    message: str

    def __post_init__(self) -> None:
        # It may quote a log of a stranger, and is shown on a terminal.
        if not self.message.isprintable():
            line = "".join(one if one.isprintable() else " " for one in self.message)
            object.__setattr__(self, "message", line)


@dataclass(frozen=True)
class Recording:
    """One run of a bench or a robot.

    Attributes:
        name: unique within its file, such as `mx106.mcap#03`.
        signals: by name.
        rig: facts of the rig.
        origin: `real`, or `simulated` with the truth in `truth`.
        source: the file it came from.
        sha256: of that file.
        clock: which stamps the times are (design law 8).
        faults: what was found wrong, and what was done about it.
        truth: parameters of a simulated recording, by name.
        extra: what the source said and no other field holds, as plain JSON values.
    """

    name: str
    signals: Mapping[str, Signal]
    rig: RigFacts
    origin: Literal["real", "simulated"]
    source: str
    sha256: str
    clock: Clock
    faults: tuple[Fault, ...] = ()
    truth: Mapping[str, float] = field(default_factory=dict)
    extra: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, signal in self.signals.items():
            if signal.name != name:
                raise LogError(f"recording '{self.name}': signal '{signal.name}' filed under '{name}'")
        # The signals of motion are those of one axis: all along it, or all about it.
        units = {**UNITS, **LINEAR_UNITS} if self.linear else UNITS
        for name, signal in self.signals.items():
            if signal.unit != units.get(name, signal.unit):
                raise LogError(f"recording '{self.name}': '{name}' is in [{signal.unit}], expected [{units[name]}]")
        object.__setattr__(self, "signals", MappingProxyType(dict(self.signals)))
        object.__setattr__(self, "truth", MappingProxyType(dict(self.truth)))
        object.__setattr__(self, "extra", MappingProxyType(dict(self.extra)))

    def signal(self, name: str) -> Signal:
        """The signal of that name.

        Raises:
            LogError: there is none; the message lists what there is.
        """
        if name not in self.signals:
            raise LogError(
                f"{self.name} has no '{name}' signal; it has {', '.join(sorted(self.signals)) or 'none at all'}"
            )
        return self.signals[name]

    @property
    def linear(self) -> bool:
        """Whether this is an axis that slides: its position, or else its goal, is in metres."""
        main = self.signals.get("position", self.signals.get("goal"))
        return main is not None and main.unit == "m"

    @property
    def duration(self) -> float:
        """Time from the first to the last sample of any signal [s]."""
        ends = [(signal.t[0], signal.t[-1]) for signal in self.signals.values()]
        return float(max(end for _, end in ends) - min(start for start, _ in ends))
