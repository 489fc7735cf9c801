"""Named ways to step the task; `tests/benchmarks/bench_physics.py` prints what each costs and changes."""

from dataclasses import replace
from math import ceil

from frasa_rl.config import Physics, Task

# Held falls rest within 0.3 deg of pitch (1.6 deg of joints, which creep without noslip) of where the model's own
# 2 ms leave them, keyframes stand up as before, standing pitch moves by 0.3 deg; about 4 times as fast.
_FAST_STEP_S = 0.00625
_NEARLY = 1e-9
NAMES = ("model", "fast")


def with_physics(task: Task, name: str) -> Task:
    """A task stepped in a named way; what the task itself says of its steps stays.

    Args:
        task: with its control period.
        name: `model` as the model file says; `fast` with steps of 6.25 ms, or the next shorter that divides the period,
            no noslip iterations, and no search for islands (it changes no number but roundings, and costs 5 %).
    """
    if name == "model" or task.compat:
        return task
    own = task.physics
    step = task.control_period_s / ceil(task.control_period_s / _FAST_STEP_S - _NEARLY)
    return replace(
        task,
        physics=replace(
            own,
            timestep=own.timestep or step,
            noslip_iterations=0 if own.noslip_iterations is None else own.noslip_iterations,
            islands=False if own.islands is None else own.islands,
        ),
    )


def own_physics(task: Task) -> Task:
    """A task stepped as the model file says, friction laws included: what a policy is measured on."""
    return task if task.compat else replace(task, physics=Physics())
