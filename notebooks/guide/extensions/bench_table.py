"""How well sets of bench runs tell each number of a servo, by Fisher information."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from frasa_sysid.bench_session import BenchSession
from frasa_sysid.calibration.friction import FIELDS as FRICTION_FIELDS
from frasa_sysid.linearised import even_spread, linearise
from frasa_sysid.problem import FitProblem, state_problem, stated_servo
from frasa_sysid.recording import FloatArray, RigFacts
from frasa_sysid.rig import runs_of
from frasa_sysid.servo import NOMINAL, PUBLISHED_M4, Servo
from frasa_sysid.simulate import simulate_bench, truth_of
from frasa_sysid.simulated_bench import BENCHES

SERVO = "mx106"
FIRST_LOAD, FIRST_GAIN = 0.535, 8.0
_QUANTILE = 1.96  # of 95 %
_MOST = 50.0  # in the table's own unit: beyond it nothing is known
# Heading, field, factor; None for a share of the value, in per cent.
Columns = tuple[tuple[str, str, float | None], ...]
BASIC: Columns = (
    ("kp %", "kp", None),
    ("damping %", "damping", None),
    ("K_v %", "damping_off", None),
    ("frictionloss %", "frictionloss", None),
    ("armature %", "armature", None),
    ("force limit %", "forcerange", None),
    ("delay ms", "delay", 1e3),
    ("zero mrad", "offset", 1e3),
)
FRICTION: Columns = (
    ("K_c mN m", "frictionloss", 1e3),
    ("K_cs mN m", "stribeck", 1e3),
    ("K_m, K_e points", "load_motor", 1e2),
    ("K_ms, K_es points", "load_motor_stribeck", 1e2),
    ("dq_s %", "stribeck_speed", None),
    ("alpha %", "stribeck_exponent", None),
)


def _first(rig: RigFacts) -> bool:
    return rig.mass == FIRST_LOAD and rig.firmware_gain == FIRST_GAIN


Sets = Mapping[str, Callable[[RigFacts], bool]]
SETS: Sets = {
    "one load, one gain, up_and_down": lambda rig: _first(rig) and rig.trajectory == "up_and_down",
    "one load, one gain, sin_time_square": lambda rig: _first(rig) and rig.trajectory == "sin_time_square",
    "one load, one gain, three without torque-off": lambda rig: _first(rig) and rig.trajectory != "lift_and_drop",
    "**one load, one gain, all four**": _first,
    "one load, three gains, all four": lambda rig: rig.mass == FIRST_LOAD,
    "three loads, one gain, all four": lambda rig: rig.firmware_gain == FIRST_GAIN,
    "three loads, three gains, without torque-off": lambda rig: rig.trajectory != "lift_and_drop",
    "**three loads, three gains, all four**": lambda rig: True,
}
LOADS: Sets = {
    "one load, three gains": lambda rig: rig.mass == FIRST_LOAD,
    "two loads, one gain": lambda rig: rig.firmware_gain == FIRST_GAIN and rig.mass != 1.2,
    "three loads, one gain": lambda rig: rig.firmware_gain == FIRST_GAIN,
    "three loads, three gains": lambda rig: True,
}


def information(root: Path) -> str:
    """A table for a servo that is Coulomb-viscous indeed."""
    return _table(root, NOMINAL[SERVO], "m1", SETS, BASIC)


def load_friction(root: Path) -> str:
    """A table of the friction of a servo whose friction depends on load and speed."""
    return _table(root, PUBLISHED_M4[SERVO], "m4", LOADS, FRICTION)


def _table(root: Path, truth: Servo, law: str, sets: Sets, columns: Columns) -> str:
    """Half of the 95 % interval that each set of runs of a simulated bench leaves."""
    servo, nominal = stated_servo(SERVO, root / "robot_model" / "nominal.xml")
    bench = replace(BENCHES[SERVO], supply_resistance=0.0)
    recordings = simulate_bench(truth, bench, "bench")
    known = {name.partition(".")[2]: value for name, value in truth_of(truth, bench).items()}
    known |= {name: getattr(truth.friction, name) for name in FRICTION_FIELDS} | {
        "frictionloss": truth.friction.coulomb
    }
    rows = [f"| | runs | {' | '.join(one[0] for one in columns)} |", f"|---|---|{'---|' * len(columns)}"]
    with BenchSession(root / "robot_model" / "bench_pendulum.xml", servo) as session:
        for name, chosen in sets.items():
            runs = runs_of([one for one in recordings if chosen(one.rig)], servo, session.options.timestep)
            problem = state_problem(servo, nominal, runs, [], session.delay_range, law=law)
            values = np.array([known[one.field] for one in problem.free])
            cells = _cells(problem, values, half_widths(problem, session, values), columns)
            rows.append(f"| {name} | {len(runs)} | {' | '.join(cells)} |")
    return "\n".join(rows) + "\n"


def half_widths(problem: FitProblem, session: BenchSession, values: FloatArray) -> FloatArray:
    """Half of the 95 % interval of each number by Fisher information, at most half of its bounds, shape (n,).

    The noise is what the residuals themselves show, with one sample for a quarter of a second.
    """
    kernel, x = session.kernel(problem.train), problem.to_unit(values)
    found = linearise(problem, kernel, x, even_spread(problem, kernel, x))
    inverse = np.linalg.pinv(np.sum(found.curvatures, axis=0), rcond=1e-12)
    half = _QUANTILE * np.sqrt(np.diag(inverse @ found.spread @ inverse))
    return np.asarray(np.minimum(half, 0.5) * [one.high - one.low for one in problem.free])


def _cells(problem: FitProblem, values: FloatArray, half: FloatArray, columns: Columns) -> list[str]:
    by_field = {one.field: (value, width) for one, value, width in zip(problem.free, values, half, strict=True)}
    cells = []
    for _, field, factor in columns:
        value, width = by_field.get(field, (1.0, np.nan))
        number = width * (100.0 / abs(value) if factor is None else factor)
        cells.append(f"{number:.2g}" if number < _MOST else "not told")
    return cells
