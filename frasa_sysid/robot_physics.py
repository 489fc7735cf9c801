r"""The virtual robot's motion: servos written out, MuJoCo for the bodies only.

Once each step of h = 0.25 ms, between `mj_step1` and `mj_step2`:

.. math::
    duty = clip(e P (q_{goal} - q_{read}), \pm u_{max}) \quad \text{every 1 ms}, \qquad
    \tau_m = \frac{k_t}{R} (duty V - k_t \dot q)

and dry friction by the law M4 of `calibration.friction`, its bound evaluated from the motor's torque
and from the load (gravity, Coriolis and contact forces) of this step.

Friction is MuJoCo's constraint row of the joint, its bound written each step, made as hard as the step
allows: with solref 2 h and impedance 0.9999 the row asks for zero speed at the end of this step, which
is the stopping clip of a single joint, but for all joints and contacts at once. A clip joint by joint
would forget that stopping one joint pushes its neighbours.

MuJoCo's Euler step is leapfrog: speeds belong to the middle of the step before. Damping enters half
implicitly (`dof_damping`), half by the speed at hand, which makes it the trapezoidal rule: errors are of
second order in h.
"""

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np
import numpy.typing as npt

from frasa_sysid.robot_body import Body, Joints
from frasa_sysid.robot_truth import RobotTruth

FloatArray = npt.NDArray[np.float64]
TIMESTEP = 0.00025  # [s]
FIRMWARE_PERIOD = 0.001  # [s]
ENCODER_COUNT = 2.0 * np.pi / 4096  # [rad] AS5045, 12 bit (ROBOTIS e-Manual, MX-106)
IDLE_CURRENT = 2.5  # [A] computer and the electronics of 20 servos
_HARD = np.array([0.9999, 0.9999, 0.001, 0.5, 2.0])  # impedance of the friction rows


@dataclass(frozen=True)
class Servos:
    """The servos of all joints, each field of shape (n,)."""

    error_gain: FloatArray
    max_duty: FloatArray
    kt: FloatArray
    R: FloatArray
    viscous: FloatArray
    coulomb: FloatArray
    stribeck: FloatArray
    load: FloatArray
    load_stribeck: FloatArray
    speed: FloatArray
    exponent: FloatArray
    zero: FloatArray

    def dry_bound(self, motor: FloatArray, external: FloatArray, speed: FloatArray) -> FloatArray:
        """Largest dry friction (law M4 without its viscous part) [N m], shape (n,)."""
        fade = np.exp(-((np.abs(speed) / self.speed) ** self.exponent))
        load = np.abs(external - motor)
        return np.asarray(self.coulomb + self.load * load + fade * (self.stribeck + self.load_stribeck * load))


@dataclass(frozen=True)
class Traces:
    """The true motion, T steps.

    Attributes:
        t: times of angles, orientation and supply [s], shape (T,).
        t_speed: times of speeds and rates [s], half a step earlier, shape (T,).
        angle: true joint angles [rad], shape (T, n).
        speed: [rad/s], shape (T, n).
        orientation: of the trunk (w, x, y, z), shape (T, 4).
        rate: angular, trunk frame [rad/s], shape (T, 3).
        volts: supply [V], shape (T,).
        motor: motor torque [N m], shape (T, n).
        touching: share of the steps with a contact.
    """

    t: FloatArray
    t_speed: FloatArray
    angle: FloatArray
    speed: FloatArray
    orientation: FloatArray
    rate: FloatArray
    volts: FloatArray
    motor: FloatArray
    touching: float


def servos_of(truth: RobotTruth, joints: Joints) -> Servos:
    """The servos of a robot, joint by joint."""
    each = [truth.servo(name) for name in joints.servos]
    laws = [one.friction for one in each]
    zeros = truth.zeros or {}
    columns = (
        [one.error_gain * truth.firmware_gain for one in each],
        [one.max_duty for one in each],
        [one.kt for one in each],
        [one.R for one in each],
        [law.viscous for law in laws],
        [law.coulomb for law in laws],
        [law.stribeck for law in laws],
        [law.load_motor for law in laws],
        [law.load_motor_stribeck for law in laws],
        [law.stribeck_speed for law in laws],
        [law.stribeck_exponent for law in laws],
        [zeros.get(name, 0.0) for name in joints.names],
    )
    return Servos(*(np.array(column) for column in columns))


def simulate(
    body: Body,
    joints: Joints,
    truth: RobotTruth,
    written: FloatArray,
    goals: FloatArray,
    end: float,
    quantized: bool = True,
    progress: Callable[[float], None] = lambda share: None,
) -> Traces:
    """Let the robot act on goals.

    Args:
        body: compiled for this truth.
        joints: of the model.
        truth: servos, delays, battery.
        written: stamps of the goals [s], increasing, shape (C,); the simulation starts at the first.
        goals: in the servos' own angles [rad], shape (C, n).
        end: time at which to stop [s].
        quantized: the servo reads its own encoder in counts.
        progress: called now and then with the share done.

    Returns:
        The true motion from the first command on, every step.
    """
    servos, model = servos_of(truth, joints), body.model
    h, n = float(model.opt.timestep), len(joints.names)
    data = _ready(body, servos, goals[0])
    steps = int(np.ceil((end - written[0]) / h))
    ticks = max(1, round(FIRMWARE_PERIOD / h))
    t = written[0] + np.arange(steps) * h
    acted = np.maximum(np.searchsorted(written + truth.command_delay, t + 1e-9, side="right") - 1, 0)
    count = ENCODER_COUNT if quantized else 0.0
    angle, speed, motors = np.empty((steps, n)), np.empty((steps, n)), np.empty((steps, n))
    orientation, rate, volts = np.empty((steps, 4)), np.zeros((steps, 3)), np.empty(steps)
    floating = truth.base == "floating"
    supply, duty, contact, touched = truth.open_voltage, np.zeros(n), np.zeros(n), 0
    torque_per_volt, back_emf = servos.kt / servos.R, servos.kt**2 / servos.R
    half_damping = (servos.viscous + back_emf) / 2.0
    for k in range(steps):
        mujoco.mj_step1(model, data)
        q, v = data.qpos[body.qpos], data.qvel[body.dof]
        if k % ticks == 0:
            read = q + servos.zero
            read = np.round(read / count) * count if count else read
            duty = np.clip(servos.error_gain * (goals[acted[k]] - read), -servos.max_duty, servos.max_duty)
        driven = torque_per_volt * supply * duty
        motor = driven - back_emf * v
        external = contact - data.qfrc_bias[body.dof]
        data.efc_frictionloss[:n] = servos.dry_bound(motor, external, v)
        data.qfrc_applied[body.dof] = driven - half_damping * v
        angle[k], speed[k], motors[k], volts[k] = q, v, motor, supply
        if floating:
            orientation[k], rate[k] = data.qpos[3:7], data.qvel[3:6]
        mujoco.mj_step2(model, data)
        touched += data.ncon > 0
        # What the floor does to a joint, of the step before: contacts and friction are solved together.
        contact = data.qfrc_constraint[body.dof] - data.efc_force[:n]
        # Each servo draws the share of its winding's current for which the bridge is on.
        drawn = float(duty @ (motor / servos.kt))
        supply = truth.open_voltage - truth.resistance * max(drawn + IDLE_CURRENT, 0.0)
        if k % 2000 == 0:
            progress(k / steps)
    if not floating:
        orientation[:] = data.xquat[model.body(joints.trunk).id]
    return Traces(t, t - h / 2.0, angle, speed, orientation, rate, volts, motors, touched / steps)


def _ready(body: Body, servos: Servos, goal: FloatArray) -> mujoco.MjData:
    """State at the start, every servo joint with a friction row of its own, in the order of the joints."""
    model = body.model
    model.dof_frictionloss[body.dof] = 1.0
    model.dof_damping[body.dof] = (servos.viscous + servos.kt**2 / servos.R) / 2.0
    model.dof_solref[body.dof] = [2.0 * model.opt.timestep, 1.0]
    model.dof_solimp[body.dof] = _HARD
    data = mujoco.MjData(model)
    data.qpos[:] = body.start
    data.qpos[body.qpos] = goal - servos.zero
    mujoco.mj_forward(model, data)
    return data
