"""What a robot must know to run a policy: joints, servos, limits, rates, what is observed and how old it is.

It stands beside run.yaml and not in it: run.yaml says how a policy came about and is nobody's business on a
robot; this needs the compiled model, changes with no training setting, and is JSON because the runtime has no YAML.
"""

import json
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from frasa_rl.config import Task
from frasa_rl.observation import layout
from frasa_rl.physics import own_physics
from frasa_rl.reward import target
from frasa_rl.robot import Robot, Sensors, find_robot
from frasa_rl.runtime import SCHEMA
from frasa_rl.task_model import build_model
from frasa_sysid.calibration import calibration_id, load_model, model_sha256, plain

FASTEST = 5.0  # times the rate of training: the protocol's 100 Hz for a policy of 20 Hz
_DIGITS = 9
_MEANINGS = {
    "position": "joint angles",
    "velocity": "joint rates",
    "command": "angles commanded at this instant, seen from the left",
    "pitch": "of the trunk, 0 upright, forward positive: atan2(-R[2, 0], R[2, 2]), axes x forward, y left, z up",
    "pitch_rate": "angular rate about the trunk's own y axis",
    "previous_action": "mean of the actions applied over the last control period of training, 0 before the first",
}


def deployment(run: dict[str, Any], task: Task, model_path: Path) -> dict[str, Any]:
    """Describe a policy for the robot, as plain data.

    Args:
        run: the content of its run.yaml.
        task: what it was trained to do.
        model_path: of the robot, with the servos it was trained with.

    Raises:
        ModelError: the model is broken or lacks something.
    """
    model = build_model(model_path, own_physics(task))
    robot = find_robot(model, task)
    settings, trained = run.get("settings"), run.get("trained")
    whole = load_model(model_path)
    said = {
        "schema": SCHEMA,
        "compat": task.compat,
        "calibration_id": run.get("calibration_id"),
        "trained": {
            "model": Path(str(run.get("model", model_path))).name,
            "model_sha256": run.get("model_sha256"),
            "seed": settings.get("seed") if isinstance(settings, dict) else None,
            "steps": trained.get("steps") if isinstance(trained, dict) else None,
            "origin": run.get("origin", "frasa-rl train"),
            "versions": run.get("versions"),
        },
        "model": {
            "file": model_path.name,
            "calibration_id": calibration_id(whole),
            "sha256": model_sha256(whole),
            "mujoco": mujoco.__version__,
        },
        "control": {
            "period_s": task.control_period_s,
            "rate_hz": 1.0 / task.control_period_s,
            "lowest_hz": 1.0 / task.control_period_s,
            "highest_hz": (1.0 if task.compat else FASTEST) / task.control_period_s,
        },
        "action": {
            "type": "joint_rate",
            "meaning": "share of the rate limit; the command moves by it, in a line over the period, inside its limits",
            "low": -1.0,
            "high": 1.0,
            "rate_limit_rad_s": task.rate_limit,
        },
        "joints": _joints(task, robot),
        "held": _held(model, robot),
        "standing_pitch_rad": float(target(task)[-1]),
        "observation": _observation(model, task, robot),
        "servos": [_servo(model, index) for index in range(model.nu)],
    }
    return dict(_rounded(plain(said)))


def _joints(task: Task, robot: Robot) -> list[dict[str, Any]]:
    """What the policy moves; angles as seen from the left, where the right side has them times mirror."""
    said = []
    for joint, (low, high), standing in zip(task.joints, robot.limits, target(task)[:-1], strict=True):
        left, right = task.names.pair(joint)
        limits = {"command_low_rad": low, "command_high_rad": high}
        names = {"name": joint.name, "left": left, "right": right, "mirror": joint.mirror}
        said.append({**names, "standing_rad": standing, **limits})
    return said


def _held(model: mujoco.MjModel, robot: Robot) -> dict[str, float]:
    """Fixed commands of all joints that the policy does not move [rad]."""
    moved = set(robot.actuators.ravel().tolist())
    return {_joint_of(model, index): robot.held[index] for index in range(model.nu) if index not in moved}


def _observation(model: mujoco.MjModel, task: Task, robot: Robot) -> list[dict[str, Any]]:
    sensors = {
        "position": robot.position, "velocity": robot.velocity, "pitch": robot.orientation, "pitch_rate": robot.gyro,
    }  # fmt: skip
    joints = [one.name for one in task.joints]
    said = []
    for part in layout(task):
        entry: dict[str, Any] = {"name": part.name, "size": part.size, "unit": part.unit, "bound": part.bound}
        entry["meaning"] = _MEANINGS[part.name]
        if part.size > 1:
            entry["joints"] = joints
        if part.name in ("position", "velocity"):
            entry["sides"] = "left" if task.compat else "mean of left and mirror * right"
        if part.name in sensors:
            entry["delay_s"] = _delay(model, sensors[part.name])
        said.append(entry)
    return said


def _delay(model: mujoco.MjModel, sensors: Sensors) -> float:
    """The mean age of readings in the model [s]; 0 where the truth is read."""
    return float(np.mean(model.sensor_delay[sensors.ids])) if sensors else 0.0


def _servo(model: mujoco.MjModel, index: int) -> dict[str, Any]:
    """A servo's numbers in the model: gains in N m/rad and N m s/rad, torque in N m, angles in rad, delay in s."""
    dof = int(model.jnt_dofadr[model.actuator_trnid[index, 0]])
    limited = bool(model.actuator_forcelimited[index])
    low, high = model.actuator_ctrlrange[index] if model.actuator_ctrllimited[index] else (None, None)
    return {
        "joint": _joint_of(model, index),
        "kp": model.actuator_gainprm[index, 0],
        "kv": 0.0 - model.actuator_biasprm[index, 2],
        "damping": model.dof_damping[dof],
        "frictionloss": model.dof_frictionloss[dof],
        "armature": model.dof_armature[dof],
        "force_low": model.actuator_forcerange[index, 0] if limited else None,
        "force_high": model.actuator_forcerange[index, 1] if limited else None,
        "command_low_rad": low,
        "command_high_rad": high,
        "delay_s": model.actuator_delay[index],
    }


def _joint_of(model: mujoco.MjModel, index: int) -> str:
    return str(model.joint(int(model.actuator_trnid[index, 0])).name)


def _rounded(value: Any) -> Any:  # noqa: ANN401 - plain data
    """Nine digits say a joint angle to a nanoradian; more are noise of conversions."""
    if isinstance(value, dict):
        return {name: _rounded(one) for name, one in value.items()}
    if isinstance(value, list):
        return [_rounded(one) for one in value]
    return float(f"{value:.{_DIGITS}g}") if isinstance(value, float) else value


def metadata(deploy: dict[str, Any]) -> dict[str, str]:
    """The same as text for `metadata_props`: mjlab's keys, ours, and all of it as JSON under `frasa_deploy`.

    Lists are separated by commas. Actions are one a joint *pair* and are rates: a reader that takes them for
    positions of `joint_names` has the wrong number of them, and `action_type` says so.
    """
    joints, parts = deploy["joints"], deploy["observation"]
    servos = {one["joint"]: one for one in deploy["servos"]}
    both = [(joint, joint[side], sign) for joint in joints for side, sign in (("left", 1), ("right", joint["mirror"]))]
    pairs = list({one[1]: one for one in reversed(both)}.values())[::-1]  # a joint on the midline stands once
    names = [name for _, name, _ in pairs]
    lists = {
        "joint_names": names,
        "joint_stiffness": [servos[name]["kp"] for name in names],
        "joint_damping": [servos[name]["kv"] for name in names],
        "joint_viscous_friction": [servos[name]["damping"] for name in names],
        "joint_torque_limit": [servos[name]["force_high"] for name in names],
        "joint_mirror": [sign for _, _, sign in pairs],
        "joint_actions": [joints.index(joint) for joint, _, _ in pairs],
        "joint_command_low": [servos[name]["command_low_rad"] for name in names],
        "joint_command_high": [servos[name]["command_high_rad"] for name in names],
        "joint_command_delay": [servos[name]["delay_s"] for name in names],
        "default_joint_pos": [joint["standing_rad"] * sign for joint, _, sign in pairs],
        "held_joint_names": list(deploy["held"]),
        "held_joint_pos": list(deploy["held"].values()),
        "command_names": [],
        "action_names": [joint["name"] for joint in joints],
        "action_scale": [deploy["action"]["rate_limit_rad_s"]] * len(joints),
        "observation_names": [one["name"] for one in parts],
        "observation_sizes": [one["size"] for one in parts],
        "observation_units": [one["unit"] for one in parts],
        "observation_delays": [one.get("delay_s", 0.0) for one in parts],
        "observation_terms_scale": [1.0] * len(parts),
        "observation_terms_clip": [f"{-one['bound']:.9g};{one['bound']:.9g}" for one in parts],
        "observation_terms_history_length": [0] * len(parts),
        "observation_terms_flatten_history_dim": [1] * len(parts),
    }
    single = {
        "run_path": deploy["trained"]["origin"],
        "action_type": deploy["action"]["type"],
        "action_unit": "rad/s",
        "control_dt": deploy["control"]["period_s"],
        "control_rates_hz": f"{deploy['control']['lowest_hz']:g}..{deploy['control']['highest_hz']:g}",
        "calibration_id": deploy["calibration_id"] or "none (nominal)",
        "model_xml_sha256": deploy["model"]["sha256"],
        "frasa_version": deploy["frasa_version"],
        "seed": deploy["trained"]["seed"],
        "frasa_deploy": json.dumps(deploy, separators=(",", ":"), allow_nan=False),
    }
    return {**{name: ",".join(map(str, one)) for name, one in lists.items()}, **{n: str(v) for n, v in single.items()}}
