"""Does the published model do what the fit saw?

MuJoCo itself, with the numbers read back from the
compiled model, against the compiled kernel with the fitted ones, on every log.

What no model carries (effects of bench and firmware) is off on both sides: the publication lists it.
"""

from dataclasses import replace

import mujoco
import numpy as np

from frasa_sysid.bench_session import BenchSession
from frasa_sysid.calibration import SERVO_FIELDS, read, servo_law
from frasa_sysid.calibration.friction import FIELDS as FRICTION_FIELDS
from frasa_sysid.fit import FitResult
from frasa_sysid.publish import check_replay, replay_tolerance
from frasa_sysid.recording import FloatArray
from frasa_sysid.rig import BenchRun
from frasa_sysid.servo_values import ServoValues
from frasa_sysid.stand_in import StandIn, without_effects


def replay(model: mujoco.MjModel, result: FitResult, other: StandIn | None, session: BenchSession) -> tuple[float, int]:
    """Largest difference between MuJoCo with the published numbers and the fit [rad], and the number of runs.

    Args:
        model: the published robot model, compiled.
        result: the fit.
        other: the M1 stand-in that was published in its place, if one was.
        session: of the fit.

    Raises:
        QualityError: more than 0.1 mrad (M1) or 1 mrad (M2 to M6).
    """
    fitted = without_effects(result.problem.servo_values(result.values) if other is None else other.values)
    published = _published(model, result.problem.servo.name, fitted)
    worst, count = 0.0, 0
    for offset, runs in _by_offset(result).items():
        ours, theirs = (replace(one, offset=one.offset + offset) for one in (fitted, published))
        kernel = session.kernel(runs)
        seen = kernel.split(kernel.readings(ours.array()[None])[0])
        with session.mujoco(law=other is None and result.friction != "m1") as simulator:
            replayed = simulator.simulate(runs, [theirs])[0]
        law = "m1" if other is not None else result.friction
        worst = max(worst, check_replay(*_both_sound(seen, replayed), replay_tolerance(law)))
        count += len(runs)
    return worst, count


def _published(model: mujoco.MjModel, servo: str, bench: ServoValues) -> ServoValues:
    """The servo as the compiled model has it; what has no place there (zero offset) as fitted."""
    values = replace(bench, **{field: read(model, f"{servo}.{field}") for field in SERVO_FIELDS})
    friction = servo_law.law(model, servo)
    if friction is None:
        return values
    shared = {name: getattr(friction, name) for name in FRICTION_FIELDS if name != "coulomb"}
    return replace(values, frictionloss=friction.coulomb, damping_off=friction.viscous, **shared)


def _by_offset(result: FitResult) -> dict[float, list[BenchRun]]:
    """Runs by the zero offset that their rig has beside the common one [rad]."""
    problem = result.problem
    runs = [*problem.train, *problem.held_out]
    offsets = problem.offsets(problem.to_unit(result.values)[None], runs)
    groups: dict[float, list[BenchRun]] = {}
    for i, run in enumerate(runs):
        groups.setdefault(0.0 if offsets is None else float(offsets[0, i]), []).append(run)
    return groups


def _both_sound(seen: list[FloatArray], replayed: list[FloatArray]) -> tuple[list[FloatArray], list[FloatArray]]:
    """NaN of both at the same samples says that both diverged there, which is agreement."""
    pairs = [(np.where(np.isnan(a) & np.isnan(b), 0.0, a), np.where(np.isnan(a) & np.isnan(b), 0.0, b))
             for a, b in zip(seen, replayed, strict=True)]  # fmt: skip
    return [a for a, _ in pairs], [b for _, b in pairs]
