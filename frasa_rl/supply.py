"""An assumed supply voltage: gain and torque limit of every position servo scale with it, damping does not."""

from functools import cache

import mujoco
import numpy as np

from frasa_rl.config import Assumed, Task
from frasa_sysid.calibration import number, say
from frasa_sysid.calibration.apply import STATED_SUPPLY


def nominal_voltage(model: mujoco.MjModel, task: Task) -> float | None:
    """Supply at which gains and torque limits of a model hold [V]: the task's number, else the model's, else None."""
    if task.nominal_voltage is not None:
        return task.nominal_voltage
    stated = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, STATED_SUPPLY) >= 0
    return number(model, STATED_SUPPLY) if stated else None


def assumed_supply(model: mujoco.MjModel, task: Task) -> Assumed | None:
    """The range to draw the supply's ratio from; None where none is assumed, or it is in volts of an unknown supply.

    The latter is said, once in a process.
    """
    one = task.assumed.supply_voltage
    if one is None or one.unit == "ratio":
        return one
    volts = nominal_voltage(model, task)
    if volts is None:
        _say_once(
            "the supply voltage stays as it is: neither the task (nominal_voltage) nor the model "
            f"({STATED_SUPPLY}) says at how many volts its gains hold; assumed.supply_voltage may be a ratio, or null"
        )
        return None
    return Assumed(one.low / volts, one.high / volts, "ratio", one.source)


def scale_supply(model: mujoco.MjModel, ratio: float) -> None:
    """Give all position servos another supply, in place."""
    servos = np.flatnonzero(model.actuator_biasprm[:, 1] < 0.0)
    model.actuator_gainprm[servos, 0] *= ratio
    model.actuator_biasprm[servos, 1] *= ratio
    model.actuator_forcerange[servos] *= ratio


@cache
def _say_once(text: str) -> None:
    say(text)
