"""The Coulomb-viscous servo (M1) that best stands in for a richer one, and what that costs.

The richer servo is simulated on the logs' own goals and loads, and M1 is fitted to what it
does there: so the range of loads and speeds for which the stand-in holds is that of the logs.
"""

from dataclasses import dataclass, replace

import numpy as np

from frasa_sysid.bench_session import BenchSession
from frasa_sysid.cost import Misfit, misfit
from frasa_sysid.fit import FitResult, exact_candidate, simulated, with_law
from frasa_sysid.restarts import solve
from frasa_sysid.servo_values import NO_LIMIT, ServoValues


@dataclass(frozen=True)
class StandIn:
    """An M1 servo in place of a richer one.

    Attributes:
        values: its numbers.
        penalty: mean difference between the two on the logs' motions.
        loads: smallest and largest gravity torque at the horizontal [N m].
        speed: largest joint speed [rad/s] that was simulated.
    """

    values: ServoValues
    penalty: Misfit
    loads: tuple[float, float]
    speed: float


def stand_in(result: FitResult, session: BenchSession) -> StandIn:
    """Fit M1 to what a richer fit does.

    Args:
        result: of a fit with a law beyond M1, or with effects.
        session: simulates.
    """
    runs = result.problem.train
    rich = simulated(result, session, runs)
    imitated = tuple(
        replace(run, y=np.where(np.isfinite(reading), reading, run.y)) for run, reading in zip(runs, rich, strict=True)
    )
    # Effects of the bench and of the firmware stay as they are; only the friction law is exchanged.
    problem = replace(with_law(replace(result.problem, train=imitated), "m1", result.problem.effects), held_out=())
    known = dict(zip([one.name for one in result.problem.free], result.values, strict=True))
    near = problem.to_unit(np.array([known.get(one.name, one.start) for one in problem.free]))
    solved = solve(problem, session, nested=[np.clip(near, 0.0, 1.0)])
    kernel = session.kernel(imitated)
    values = problem.from_unit(solved.x)
    rows = kernel.readings(exact_candidate(problem, values)[None], problem.offsets(solved.x[None], imitated))
    speed = max(
        float(np.abs(np.diff(reading) / np.diff(run.t)).max(initial=0.0))
        for run, reading in zip(runs, rich, strict=True)
    )
    loads = [run.gravity_torque for run in runs]
    return StandIn(
        without_effects(problem.servo_values(values)),
        misfit(imitated, kernel.split(rows[0])),
        (min(loads), max(loads)),
        speed,
    )


def without_effects(values: ServoValues) -> ServoValues:
    """The same servo with everything off that no published model carries."""
    return replace(
        values,
        sag=0.0,
        rest=0.0,
        follow=0.0,
        goal_speed=NO_LIMIT,
        punch=0.0,
        dead_zone=0.0,
        collapse_at=100.0,
        collapse_to=1.0,
        bias=0.0,
        drag=0.0,
        loop_lag=0.0,
    )
