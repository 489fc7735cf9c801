"""What the compiled friction law costs: a physics step of the robot that stands on the floor, with and without it.

Every row is timed through `mujoco.rollout`, from the same states and with the same commands (new ones every
20 ms), interleaved with plain MuJoCo (constant friction loss); the ratio is the median over the repeats. Friction
changes what the solver has to do, so the iterations per step stand beside it, and the law with Coulomb friction alone,
which is evaluated but changes nothing, tells the cost of the evaluation from that of the second solve that laws
with load need. On a shared machine read the ratio of processor times.
"""

import sys
import time
from pathlib import Path

import mujoco
import numpy as np
import numpy.typing as npt
from mujoco import rollout

from frasa_sysid.calibration import actuators_of, dofs_of, servo_law
from frasa_sysid.calibration.friction import Friction
from frasa_sysid.servo import PUBLISHED_M4

ROOT = Path(__file__).resolve().parents[2]
FULL = mujoco.mjtState.mjSTATE_FULLPHYSICS
STARTS, STEPS, REPEATS = 32, 200, 15
SWING = 0.03  # [rad] of every joint about the neutral pose: it keeps standing
Floats = npt.NDArray[np.float64]


def robot(name: str) -> mujoco.MjModel:
    """The robot with places for coefficients."""
    spec = mujoco.MjSpec.from_file(str(ROOT / "robot_model" / f"{name}.xml"))
    there = {one.name for one in spec.numerics}  # a calibrated model may carry them already
    for servo in ("mx64", "mx106"):
        if servo + servo_law.SUFFIX in there:
            continue
        spec.add_numeric(name=servo + servo_law.SUFFIX, size=servo_law.NUMBERS, data=[0.0] * 9 + [1.0, 1.0])
    return spec.compile()


def goals(model: mujoco.MjModel, count: int, seed: int) -> Floats:
    """Goals of slow swings, held for 20 ms each [rad], shape (count, STEPS, nu)."""
    phases = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, (count, 1, model.nu))
    t = np.arange(STEPS)[None, :, None] // 10 * 10 * model.opt.timestep
    return np.asarray(model.key_ctrl[0] + SWING * np.sin(8.0 * t + phases))


def standing(model: mujoco.MjModel) -> Floats:
    """States of a robot that stands, shape (STARTS, n)."""
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    states = np.empty((STARTS, mujoco.mj_stateSize(model, FULL)))
    for state, ahead in zip(states, goals(model, STARTS, 0), strict=True):
        for data.ctrl[:] in ahead[:20]:
            mujoco.mj_step(model, data)
        mujoco.mj_getState(model, data, state, FULL)
    return states


def seconds_per_step(model: mujoco.MjModel, states: Floats, commands: Floats, threads: int, law: bool) -> list[float]:
    """Time on the wall and time of the processor, per physics step [s]."""
    data = [mujoco.MjData(model) for _ in range(threads)]
    if law:
        servo_law.install()
    else:
        servo_law.uninstall()
    with rollout.Rollout(nthread=threads) as runner:
        before = np.array([time.perf_counter(), time.process_time()])
        runner.rollout(model, data, states, commands)
        after = np.array([time.perf_counter(), time.process_time()])
    return list((after - before) / (STARTS * STEPS))


def iterations(model: mujoco.MjModel, states: Floats, commands: Floats) -> tuple[float, float]:
    """Mean solver iterations and constraint rows of MuJoCo's own solve, over the first run."""
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, states[0], FULL)
    seen = []
    for data.ctrl[:] in commands[0]:
        mujoco.mj_step(model, data)
        seen.append((data.solver_niter[: data.nisland].sum(), data.nefc))
    mean = np.mean(seen, axis=0)
    return float(mean[0]), float(mean[1])


def main() -> int:
    name = sys.argv[1] if len(sys.argv) > 1 else "calibrated"
    model = robot(name)
    states, commands = standing(model), goals(model, STARTS, 1)
    coulomb = {
        servo: Friction(0.0, float(model.dof_frictionloss[dofs_of(model, actuators_of(model, servo))[0]]))
        for servo in ("mx64", "mx106")
    }
    print(f"{name}.xml, {model.nv} dof, MuJoCo {mujoco.__version__}: {STARTS} runs of {STEPS} steps, {REPEATS} repeats")
    servo_law.uninstall()
    plain_iterations, rows = iterations(model, states, commands)
    print(f"plain: {plain_iterations:.2f} iterations per step, {rows:.0f} constraint rows")
    for title, friction in (("m1", coulomb), ("m4", {one: PUBLISHED_M4[one].friction for one in coulomb})):
        for servo, one in friction.items():
            servo_law.set_law(model, servo, one)
        for threads in (1, 2):
            plain, law = [], []
            for _ in range(REPEATS):
                plain.append(seconds_per_step(model, states, commands, threads, law=False))
                law.append(seconds_per_step(model, states, commands, threads, law=True))
            (wall, cpu), (wall_ratio, cpu_ratio) = (
                np.median(law, axis=0) * 1e6,
                np.median(np.divide(law, plain), axis=0),
            )
            print(
                f"{title}, {threads} thread(s): {wall:6.1f} us per step, {wall_ratio:.2f} times plain; "
                f"processor time {cpu:6.1f} us, {cpu_ratio:.2f} times plain"
            )
        servo_law.install()
        print(f"{title}: {iterations(model, states, commands)[0]:.2f} iterations per step in MuJoCo's own solve")
    servo_law.uninstall()
    return 0


if __name__ == "__main__":
    sys.exit(main())
