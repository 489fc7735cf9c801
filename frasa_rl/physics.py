"""Named ways to step the task; `tests/benchmarks/bench_physics.py` prints what each costs and changes."""

from frasa_rl.config import Physics

PHYSICS = {
    "model": Physics(),
    "fast": Physics(timestep=0.005, noslip_iterations=0),
}
