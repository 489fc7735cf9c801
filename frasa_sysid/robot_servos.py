"""What the servo classes of a robot's model are, for a virtual robot of them.

In this order: the user's own table in the folder `servos` beside the model, the servo of that name that comes with
frasa and has a published friction law, and what the model's own numbers mean as a servo with Coulomb-viscous friction.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import mujoco

from frasa_sysid.calibration import number, read, servo_classes
from frasa_sysid.calibration.friction import Friction
from frasa_sysid.errors import ModelError
from frasa_sysid.servo import FOLDER, PUBLISHED_M4, Servo, find_table

FRICTION_SHARE = 0.05  # of a model's damping that is taken for friction, the rest for back-EMF


def servo_types(path: Path, model: mujoco.MjModel) -> Mapping[str, Servo]:
    """The servo of each class, stated at the model's supply and firmware gain.

    Raises:
        ModelError: no supply or gain, or numbers that no servo has.
        InputError: a table that cannot be used.
    """
    supply, gain = number(model, "servo_supply_voltage"), number(model, "servo_firmware_gain")
    found = {}
    for name in servo_classes(model):
        if (path.parent / FOLDER / f"{name}.toml").is_file():
            table = find_table(name, path)
            one = table.simulated or table.servo
        elif name in PUBLISHED_M4:
            one = PUBLISHED_M4[name]
        else:
            one = _from_model(path, model, name, supply, gain)
        found[name] = replace(one, supply_voltage=supply, firmware_gain=gain)
    return found


def _from_model(path: Path, model: mujoco.MjModel, name: str, supply: float, gain: float) -> Servo:
    fields = ("kp", "forcerange", "damping", "frictionloss", "armature")
    kp, force, damping, friction, armature = (read(model, f"{name}.{field}") for field in fields)
    if not min(kp, force, damping, armature, supply, gain) > 0.0:
        raise ModelError(f"{path}: a number of servo class '{name}' is not above 0: no servo is like that")
    # Of kt and R only kt/R and kt^2/R reach the mechanics.
    per_volt, emf = force / supply, (1.0 - FRICTION_SHARE) * damping
    law = Friction(FRICTION_SHARE * damping, friction)
    kt = emf / per_volt
    return Servo(
        name, kp / (gain * force), 1.0, kt, kt / per_volt, armature, law, supply, gain, f"numbers of {path.name}"
    )
