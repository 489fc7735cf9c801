"""Named ways to step the task; `tests/benchmarks/bench_physics.py` prints what each costs and changes."""

from dataclasses import replace

from frasa_rl.config import Physics, Task

# Held falls rest within 0.3 deg of pitch (1.4 deg of joints, which creep without noslip) of where the model's own
# 2 ms leave them, keyframes stand up as before, standing pitch moves by 0.2 deg; 2.5 to 4 times as fast.
_FAST_STEP_S = 0.005
NAMES = ("model", "fast")


def with_physics(task: Task, name: str) -> Task:
    """A task stepped in a named way; what the task itself says of its steps stays.

    Args:
        task: with its control period.
        name: `model` as the model file says; `fast` with steps of 5 ms, where they divide the period, no noslip
            iterations, and no search for islands (which changes no number but roundings, and costs 5 %).
    """
    if name == "model" or task.compat:
        return task
    own = task.physics
    periods = task.control_period_s / _FAST_STEP_S
    step = _FAST_STEP_S if abs(periods - round(periods)) < 1e-9 else None
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
