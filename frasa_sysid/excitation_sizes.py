"""Amplitudes at which the nominal robot keeps within its limits and does not touch itself."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from frasa_sysid.errors import QualityError
from frasa_sysid.excitation_hung import Sizes, design, first_sizes
from frasa_sysid.excitation_trial import Trial, try_out
from frasa_sysid.holds import UPRIGHT
from frasa_sysid.robot_body import Joints

FloatArray = npt.NDArray[np.float64]
TORQUE_SHARE = 0.85  # of the model's force range
SPEED_SHARE = 0.7  # of the no-load speed
SHRINK = 0.9
ASIDE = 0.08  # [rad] that the centre gives way in a round
ROUNDS = 40
INSIDE = 0.98  # of the room between the centre and a command limit
SIZE_OF = {"multisine": "quick", "steps": "step", "ramps": "swing", "holds": "swing"}


def fitted_sizes(
    path: Path,
    joints: Joints,
    seconds: float,
    progress: Callable[[float], None] = lambda share: None,
    moving: Sequence[str] | None = None,
    hold: str = UPRIGHT,
    firmware_gain: float | None = None,
) -> tuple[Sizes, Trial]:
    """Try, and make smaller what asks too much.

    Args:
        path: the model.
        joints: of the model.
        seconds: duration of the excitation.
        progress: called with the share of the rounds that may be needed.
        moving: joints that may move; by default all.
        hold: how the trunk is held.
        firmware_gain: P of the servos; by default the model's own.

    Returns:
        Amplitudes, and the trial that they passed.

    Raises:
        QualityError: none were found.
    """
    sizes = first_sizes(joints)
    if moving is not None:
        free = np.isin(joints.names, list(moving))
        sizes = replace(sizes, swing=sizes.swing * free, quick=sizes.quick * free, step=sizes.step * free)
    for i in range(ROUNDS):
        excitation = design(joints, sizes, seconds, hold=hold, firmware_gain=firmware_gain)
        trial = try_out(path, joints, excitation)
        over = np.maximum(trial.torque / TORQUE_SHARE, trial.speed / SPEED_SHARE) > 1.0
        if not over.any() and not trial.touching.any():
            return sizes, trial
        # A joint that only carries what touches sideways keeps its size.
        keep = 1.0 - (1.0 - SHRINK) * np.maximum(over, trial.touching**2)
        for part, factor in zip(excitation.parts, keep, strict=True):
            if part.name in SIZE_OF:
                name = SIZE_OF[part.name]
                sizes = replace(sizes, **{name: getattr(sizes, name) * factor})
        sizes = _moved(sizes, joints, trial.apart)
        progress(i / ROUNDS)
    names = ", ".join(np.array(joints.names)[(over | (trial.touching > 0.5)).any(axis=0)])
    raise QualityError(f"no amplitude keeps {names} within torque and speed and clear of the robot itself")


def _moved(sizes: Sizes, joints: Joints, apart: FloatArray) -> Sizes:
    """The centre pose aside, for the joints that separate best, and amplitudes within the room that is left."""
    aside = np.where(np.abs(apart) > 0.5, apart, 0.0) * ASIDE
    margin = 0.15 * (joints.high - joints.low)
    centre = np.clip(sizes.centre + aside, joints.low + margin, joints.high - margin)
    room = INSIDE * np.minimum(centre - joints.low, joints.high - centre)
    return Sizes(centre, *(np.minimum(one, room) for one in (sizes.swing, sizes.quick, sizes.step)))
