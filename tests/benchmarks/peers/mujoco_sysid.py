"""The same logs fitted with MuJoCo's own `mujoco.sysid` (extra `mujoco[sysid]`).

Its residual takes one model per group of logs; loads, gains and supplies differ, so every log is a group of its own. It
knows no switch, so the torque flag is one more control channel, by actuators whose gain is affine in angle and speed;
the force limit then sits on a tendon. Logs that are powered throughout keep one plain position actuator. The delay is
`SignalTransform.delay` of the sensor (goal and position tell only the sum of delays), and the encoder's offset turns
the pendulum's centre of mass. Free numbers are multiples of their nominal value, as finite differences of one step for
all want it.
"""

import contextlib
import io
import time
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import mujoco
import numpy as np

from frasa_sysid.cost import ROBUST_WIDTH
from frasa_sysid.recording import FloatArray
from frasa_sysid.rig import BenchRun
from peers import Bench, Measured, timed

try:
    from mujoco import sysid
    from mujoco.sysid import ParameterDict

    MISSING = ""
except ImportError as problem:  # it imports, but empty, where the extra's packages are not installed
    MISSING = f"pip install 'mujoco[sysid]' ({problem})"

GRAVITY = 9.81  # [m/s^2]
LONGEST_DELAY = 0.03  # [s]
LONGEST_OFFSET = 0.15  # [rad]
# The span of our own fit, as multiples of nominal.
_SPAN = {
    "kp": (0.2, 4.0),
    "forcerange": (0.2, 3.0),
    "damping": (0.05, 4.0),
    "damping_off": (0.0, 20.0),
    "frictionloss": (0.0, 6.0),
    "armature": (0.05, 4.0),
}
_PLAIN = """
<mujoco model="{name}">
  <option timestep="{step}" integrator="implicitfast" gravity="0 0 -9.81" noslip_iterations="1"
    noslip_tolerance="1e-6"/>
  <worldbody>
    <body name="pendulum">
      <joint name="servo" axis="0 -1 0"/>
      <inertial pos="0 0 {depth}" mass="{mass}" diaginertia="{inertia} {inertia} {inertia}"/>
    </body>
  </worldbody>
  {drive}
  <sensor><jointpos name="angle" joint="servo"/></sensor>
</mujoco>
"""
_POSITION = '<actuator><position name="goal" joint="servo" kp="1" forcerange="-1 1"/></actuator>'
# Controls: goal (times power), power, power. Torque: clip(kp goal - kp q) - emf dq, all of it times power.
_SWITCHED = """
  <tendon>
    <fixed name="drive" actuatorfrclimited="true" actuatorfrcrange="-1 1"><joint joint="servo" coef="1"/></fixed>
  </tendon>
  <actuator>
    <general name="goal" tendon="drive" gaintype="fixed" gainprm="1" biastype="none"/>
    <general name="spring" tendon="drive" gaintype="affine" gainprm="0 -1 0" biastype="none"/>
    <general name="emf" joint="servo" gaintype="affine" gainprm="0 0 -1" biastype="none"/>
  </actuator>
"""


@dataclass(frozen=True)
class Fit:
    """What `mujoco.sysid` made of the logs.

    Attributes:
        values: fitted, by field.
        nominal_mae, mae: mean absolute position error before and after [rad], logs weighing alike.
        seconds: from the nominal start to convergence.
        evaluations: candidates simulated on all logs, those of finite differences included.
    """

    values: dict[str, float]
    nominal_mae: float
    mae: float
    seconds: float
    evaluations: int


class SysidBench:
    """Residuals of bench logs by `mujoco.sysid`.

    Args:
        bench: logs and servo.
        threads: of its rollout.
    """

    def __init__(self, bench: Bench, threads: int) -> None:
        self._bench = bench
        self._runs = {f"log{i}": run for i, run in enumerate(bench.runs)}
        specs = {name: mujoco.MjSpec.from_string(_xml(name, run, bench.timestep)) for name, run in self._runs.items()}
        self._models = {name: spec.compile() for name, spec in specs.items()}
        self.count = 0
        self.parameters = self._free()
        self._transform = sysid.SignalTransform(normalize=False)
        self._transform.delay("angle", self.parameters["delay"])
        groups = [self._group(name, spec) for name, spec in specs.items()]
        # The runs are on the model's grid already, so there is nothing to resample in the commands.
        self._residual = sysid.build_residual_fn(
            models_sequences=groups,
            build_model=self._model,
            modify_residual=self._transform.apply,
            n_threads=threads,
            resample_true=False,
        )

    @property
    def log_steps(self) -> int:
        """Steps of one candidate, summed over logs."""
        return sum(run.steps for run in self._bench.runs)

    def residual(self, x: FloatArray, parameters: "ParameterDict") -> tuple[list[FloatArray], object, object]:
        """What `sysid.optimize` asks for; one column of `x` per candidate."""
        self.count += 1 if x.ndim == 1 else x.shape[1]
        parts, predicted, measured = self._residual(x, parameters)
        return parts, predicted, measured

    def mae(self, x: FloatArray) -> float:
        """Mean absolute position error [rad], logs weighing alike."""
        parts = self._residual(x, self.parameters.copy())[0]
        return float(np.mean([np.mean(np.abs(part)) for part in parts]))

    def values(self, x: FloatArray) -> dict[str, float]:
        """By field, in the field's own unit."""
        parameters = self.parameters.copy()
        parameters.update_from_vector(x)
        return {name: self._value(parameters, name) for name in parameters.keys()}  # noqa: SIM118 (no mapping)

    def _free(self) -> "ParameterDict":
        switched = any(_switched(run) for run in self._bench.runs)
        parameters = ParameterDict()
        for name, (low, high) in _SPAN.items():
            if name != "damping_off" or switched:
                parameters.add(sysid.Parameter(name, 1.0, low, high))
        parameters.add(sysid.Parameter("offset", 0.0, -1.0, 1.0))
        parameters.add(sysid.Parameter("delay", 0.0, 0.0, LONGEST_DELAY))
        return parameters.move_off_bounds()

    def _value(self, parameters: "ParameterDict", name: str) -> float:
        if name not in parameters:
            return self._bench.nominal[name]
        value = float(parameters[name].value[0])
        if name == "delay":
            return value + self._bench.timestep  # its sensors are read before a step and stamped after it
        return value * (LONGEST_OFFSET if name == "offset" else self._bench.nominal[name])

    def _group(self, name: str, spec: mujoco.MjSpec) -> object:
        run, model = self._runs[name], self._models[name]
        times = np.arange(run.steps + 1) * self._bench.timestep
        control = sysid.TimeSeries.from_control_names(times, _controls(run, self._bench.timestep), model)
        measured = sysid.TimeSeries.from_names(run.t, run.y[:, None], model, names=["angle"])
        start = sysid.create_initial_state(model, np.array([run.q0]), np.array([run.dq0]))
        return sysid.ModelSequences(name, spec, name, start, control, measured)

    def _model(self, parameters: "ParameterDict", spec: mujoco.MjSpec) -> mujoco.MjModel:
        name = spec.modelname
        run = self._runs[name]
        value = {field: self._value(parameters, field) for field in (*_SPAN, "offset")}
        kp, limit = value["kp"] * run.kp_scale, value["forcerange"] * run.force_scale
        emf = value["damping"] - value["damping_off"]
        distance = _distance(run)
        # In the encoder's angle the arm hangs straight down at `offset`.
        centre = (distance * np.sin(value["offset"]), 0.0, -distance * np.cos(value["offset"]))
        joint = spec.joint("servo")
        joint.frictionloss, joint.armature = value["frictionloss"], value["armature"]
        spec.body("pendulum").ipos = centre
        if _switched(run):
            joint.damping[0] = value["damping_off"]
            spec.actuator("goal").gainprm[0], spec.actuator("spring").gainprm[1] = kp, -kp
            spec.actuator("emf").gainprm[2] = -emf
            spec.tendon("drive").actfrcrange = (-limit, limit)
        else:
            joint.damping[0] = value["damping"]
            spec.actuator("goal").gainprm[0], spec.actuator("goal").biasprm[1] = kp, -kp
            spec.actuator("goal").forcerange = (-limit, limit)
        # Compiled anew, as it does by default: writing into a compiled model measured no quicker.
        return spec.compile()


def _switched(run: BenchRun) -> bool:
    return bool(run.switches.size) or not run.powered_first


def _distance(run: BenchRun) -> float:
    """Of the mass from the axis [m]; what inertia it leaves is about its centre."""
    return 0.9 * run.inertia * GRAVITY / run.gravity_torque if run.gravity_torque > 0.0 else 0.0


def _xml(name: str, run: BenchRun, timestep: float) -> str:
    distance = _distance(run)
    mass = run.gravity_torque / (GRAVITY * distance) if distance else 1e-3
    rest = run.inertia - mass * distance**2
    drive = _SWITCHED if _switched(run) else _POSITION
    return _PLAIN.format(name=name, step=timestep, depth=-distance, mass=mass, inertia=rest, drive=drive)


def _controls(run: BenchRun, timestep: float) -> FloatArray:
    """Controls by step, shape (steps + 1, channels); the last row is never applied."""
    command = np.append(run.command, run.command[-1])[:, None]
    if not _switched(run):
        return command
    edges = np.arange(run.steps + 2) * timestep
    power, on, since = np.zeros(edges.size), run.powered_first, 0.0
    for turn in [*run.switches, np.inf]:
        if on:
            power += np.clip(edges, since, turn) - since
        on, since = not on, turn
    share = np.diff(power)[:, None] / timestep
    return np.hstack([share * command, share, share])


def measure(bench: Bench, threads: int, candidates: int = 1) -> Measured:
    """Time its residual at the nominal start.

    Args:
        bench: logs and servo.
        threads: of its rollout, which share candidates, not logs.
        candidates: simulated together, as its finite differences do; the time is that of one of them.
    """
    one = SysidBench(bench, threads)
    x = one.parameters.as_vector()
    batch = x if candidates == 1 else np.tile(x[:, None], candidates)
    timing = timed(lambda: one.residual(batch, one.parameters))
    return Measured(timing.per(candidates), one.log_steps, bench.seconds, lambda: one.mae(x))


# Optimizer and its settings, by what they are called here. All see parameters scaled to about 1.
SETTINGS: Mapping[str, tuple[str, Mapping[str, object]]] = MappingProxyType(
    {
        "least squares (its default)": ("mujoco", {"x_scale": "jac", "eps": 1e-4}),
        "soft L1 (scipy)": (
            "scipy_parallel_fd",
            {"x_scale": "jac", "diff_step": 1e-4, "loss": "soft_l1", "f_scale": ROBUST_WIDTH},
        ),
    }
)


def fit(bench: Bench, threads: int, optimizer: str, settings: Mapping[str, object]) -> Fit:
    """Fit the logs from the nominal start until `mujoco.sysid` says it converged.

    Args:
        bench: logs and servo.
        threads: of its rollout.
        optimizer: `mujoco`, `scipy` or `scipy_parallel_fd`.
        settings: of the optimizer.
    """
    one = SysidBench(bench, threads)
    start = one.parameters.as_vector()
    nominal = one.mae(start)
    one.count = 0
    began = time.perf_counter()
    with contextlib.redirect_stdout(io.StringIO()):  # one line per iteration otherwise
        _, result = sysid.optimize(one.parameters, one.residual, optimizer=optimizer, verbose=False, **settings)
    seconds = time.perf_counter() - began
    x = np.asarray(result.x).reshape(-1)
    return Fit(one.values(x), nominal, one.mae(x), seconds, one.count)
