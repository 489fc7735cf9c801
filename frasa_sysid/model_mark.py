"""What tells one robot from another: a fit of a whole robot is valid for the model it was made with only."""

from dataclasses import dataclass

import mujoco
import numpy as np

from frasa_sysid.calibration import sha256_of

_FIELDS = (
    "jnt_type",
    "jnt_axis",
    "jnt_pos",
    "jnt_bodyid",
    "qpos0",
    "body_parentid",
    "body_pos",
    "body_quat",
    "body_mass",
    "body_inertia",
    "body_ipos",
    "body_iquat",
    "actuator_trnid",
)


@dataclass(frozen=True)
class ModelMark:
    """Name and fingerprint of a model.

    Attributes:
        name: in its file.
        fingerprint: hexadecimal, of its bodies, joints, actuators and time step; see `mark_of`.
    """

    name: str
    fingerprint: str


def mark_of(model: mujoco.MjModel) -> ModelMark:
    """The mark of a nominal model.

    No servo number is part of it, so the same robot before and after a bench fit has one mark. Numbers are
    rounded to nine digits: another machine's last bit is no other robot.
    """
    parts = [_names(model, kind) for kind in ("jnt", "body", "actuator")]
    for field in _FIELDS:
        values = np.asarray(getattr(model, field), dtype=np.float64).ravel() + 0.0  # no negative zeros
        parts.append(" ".join(f"{one:.9g}" for one in values))
    parts.append(f"{model.opt.timestep:.9g}")
    return ModelMark(_text(model, 0), sha256_of("\n".join(parts).encode())[:16])


def _names(model: mujoco.MjModel, kind: str) -> str:
    return " ".join(_text(model, int(start)) for start in getattr(model, f"name_{kind}adr"))


def _text(model: mujoco.MjModel, start: int) -> str:
    names = bytes(model.names)
    return names[start : names.index(b"\0", start)].decode()
