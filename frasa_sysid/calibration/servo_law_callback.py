"""The friction law as a C function that MuJoCo calls at every physics step, without Python and its lock.

`mjcb_control` runs when positions, velocities and the rows of the constraints are known and before
actuation. The function asks MuJoCo itself for the torques of this very step, delayed commands and
force limits included, evaluates the law, and writes the bound into the joint's own friction row.
That row belongs to the `mjData`, so threads that share a model do not meet.

External torque is all that acts on the joint but its motor, its damping and its friction row:
gravity, Coriolis, applied forces, springs, and what limits, equalities and contacts pass on. The
last are unknown until the step is solved. So where there are such rows, the step is solved first
with a bound that takes the load to balance the motor, as it does at rest, and MuJoCo then solves
again, from that solution, with the bound that follows. Nothing is kept from step to step:
a result depends on MuJoCo's own state alone, whichever thread or `mjData` a rollout gives it.

All that it needs stands in the model: which coefficients (custom number `<servo>_friction`),
which joints (custom tuple `<servo>`). Copies and changed coefficients therefore just work.
"""

import ctypes
from typing import Any

import mujoco
import numpy as np
from numba import cfunc, types

from frasa_sysid.calibration.friction import friction_loss
from frasa_sysid.calibration.servo_law import NUMBERS, SUFFIX
from frasa_sysid.calibration.servo_law_layout import DATA_FIELDS, MODEL_FIELDS, library, offsets
from frasa_sysid.calibration.servo_law_memory import (
    INTEGER,
    NUMBER,
    compiled,
    integer_at,
    number_at,
    put,
    read_byte,
    read_int,
    read_number,
    read_word,
)

_MODEL = offsets("mjModel", MODEL_FIELDS)
_DATA = offsets("mjData", DATA_FIELDS)
_NNUMERIC, _NTUPLE = _MODEL["nnumeric"], _MODEL["ntuple"]
_NUMERIC_ADR, _NUMERIC_SIZE, _NUMERIC_DATA = _MODEL["numeric_adr"], _MODEL["numeric_size"], _MODEL["numeric_data"]
_NUMERIC_NAME, _TUPLE_NAME, _NAMES = _MODEL["name_numericadr"], _MODEL["name_tupleadr"], _MODEL["names"]
_TUPLE_ADR, _TUPLE_SIZE = _MODEL["tuple_adr"], _MODEL["tuple_size"]
_TUPLE_TYPE, _TUPLE_ID = _MODEL["tuple_objtype"], _MODEL["tuple_objid"]
_ACTUATOR_KIND, _ACTUATOR_TARGET = _MODEL["actuator_trntype"], _MODEL["actuator_trnid"]
_JOINT_KIND, _JOINT_DOF, _DAMPING = _MODEL["jnt_type"], _MODEL["jnt_dofadr"], _MODEL["dof_damping"]
_NE, _NF, _NEFC, _NISLAND = _DATA["ne"], _DATA["nf"], _DATA["nefc"], _DATA["nisland"]
_SPEED, _SMOOTH, _MOTOR = _DATA["qvel"], _DATA["qfrc_smooth"], _DATA["qfrc_actuator"]
_DAMPER, _CONSTRAINT = _DATA["qfrc_damper"], _DATA["qfrc_constraint"]
_ROW_KIND, _ROW_ID, _ROW_FORCE = _DATA["efc_type"], _DATA["efc_id"], _DATA["efc_force"]
_ROW_LOSS = _DATA["efc_frictionloss"]
_ISLAND_ROW, _ISLAND_LOSS = _DATA["map_efc2iefc"], _DATA["iefc_frictionloss"]

_I, _F = INTEGER, NUMBER
_SUFFIX = np.frombuffer(SUFFIX.encode(), np.int8)
_FRICTION_DOF = int(mujoco.mjtConstraint.mjCNSTR_FRICTION_DOF)
_ACTUATOR = int(mujoco.mjtObj.mjOBJ_ACTUATOR)
_JOINT = int(mujoco.mjtTrn.mjTRN_JOINT)
_SLIDE, _HINGE = int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE)
_ALONE, _BALANCED, _SOLVED = 0, 1, 2  # what is known of the external torque


def _function(name: str) -> Any:  # noqa: ANN401 (a ctypes function)
    function = getattr(library(), name)
    function.argtypes, function.restype = (ctypes.c_ssize_t, ctypes.c_ssize_t), None
    return function


_actuation = _function("mj_fwdActuation")
_acceleration = _function("mj_fwdAcceleration")
_solve = _function("mj_fwdConstraint")


@compiled(types.boolean(_I, _I))
def _is_law(model: int, i: int) -> bool:
    """Whether custom number `i` has as many values as a law and a name that ends like one's."""
    if integer_at(model, _NUMERIC_SIZE, i) != NUMBERS:
        return False
    name = read_word(model + _NAMES) + integer_at(model, _NUMERIC_NAME, i)
    length = 0
    while read_byte(name + length) != 0:
        length += 1
    if length <= _SUFFIX.size:
        return False
    same = 0
    for k in range(_SUFFIX.size):
        same += read_byte(name + length - _SUFFIX.size + k) == _SUFFIX[k]
    return same == _SUFFIX.size


@compiled(_I(_I, _I))
def _class_of(model: int, i: int) -> int:
    """The custom tuple named as custom number `i` without its suffix; -1 when there is none."""
    names = read_word(model + _NAMES)
    wanted = names + integer_at(model, _NUMERIC_NAME, i)
    for t in range(read_int(model + _NTUPLE)):
        name = names + integer_at(model, _TUPLE_NAME, t)
        k = 0
        while read_byte(name + k) != 0 and read_byte(name + k) == read_byte(wanted + k):
            k += 1
        # What is left of the number's name starts with the suffix, and it ends with it: it is the suffix.
        left = 0
        while read_byte(wanted + k + left) != 0:
            left += 1
        if read_byte(name + k) == 0 and left == _SUFFIX.size:
            return t
    return -1


@compiled(_I(_I, _I))
def _dof_of(model: int, element: int) -> int:
    """Degree of freedom of a tuple's element; -1 unless it is an actuator on a hinge or a slide."""
    if integer_at(model, _TUPLE_TYPE, element) != _ACTUATOR:
        return -1
    actuator = integer_at(model, _TUPLE_ID, element)
    if integer_at(model, _ACTUATOR_KIND, actuator) != _JOINT:
        return -1
    joint = integer_at(model, _ACTUATOR_TARGET, 2 * actuator)
    kind = integer_at(model, _JOINT_KIND, joint)
    return integer_at(model, _JOINT_DOF, joint) if kind in (_HINGE, _SLIDE) else -1


@compiled(_I(_I, _I))
def _row_of(data: int, dof: int) -> int:
    """Constraint row of a joint's own friction; -1 when there is none, as for a body that sleeps."""
    first = read_int(data + _NE)
    count = read_int(data + _NF)
    if count == 0:
        return -1
    # Rows stand in the order of the joints, so it is mostly as far from the first row as the joint from its joint.
    guess = max(0, min(dof - integer_at(data, _ROW_ID, first), count - 1))
    for k in range(count):
        row = first + (guess + k) % count
        if integer_at(data, _ROW_ID, row) == dof and integer_at(data, _ROW_KIND, row) == _FRICTION_DOF:
            return row
    return -1


@compiled(_F(_I, _I, _I, _F, _I))
def _external(data: int, dof: int, row: int, motor: float, known: int) -> float:
    """Torque on a joint from all but its motor, its damping and its own friction [N m]."""
    if known == _BALANCED:
        return -motor
    torque = number_at(data, _SMOOTH, dof) - number_at(data, _MOTOR, dof) - number_at(data, _DAMPER, dof)
    if known == _SOLVED:
        torque += number_at(data, _CONSTRAINT, dof) - number_at(data, _ROW_FORCE, row)
    return torque


@compiled(types.void(_I, _I, _I))
def _write(model: int, data: int, known: int) -> None:
    """Evaluate the law of every joint that has one and write it into the joint's friction row."""
    for i in range(read_int(model + _NNUMERIC)):
        group = _class_of(model, i) if _is_law(model, i) else -1
        if group < 0:
            continue
        c = read_word(model + _NUMERIC_DATA) + 8 * integer_at(model, _NUMERIC_ADR, i)
        start = integer_at(model, _TUPLE_ADR, group)
        for element in range(start, start + integer_at(model, _TUPLE_SIZE, group)):
            dof = _dof_of(model, element)
            row = _row_of(data, dof) if dof >= 0 else -1
            if row < 0:
                continue
            speed = number_at(data, _SPEED, dof)
            # What of the joint's damping is not friction is the motor's back-EMF.
            motor = number_at(data, _MOTOR, dof) - (number_at(model, _DAMPING, dof) - read_number(c)) * speed
            external = _external(data, dof, row, motor, known)
            loss = friction_loss(
                motor, external, speed,
                read_number(c + 8), read_number(c + 16), read_number(c + 24), read_number(c + 32), read_number(c + 40),
                read_number(c + 48), read_number(c + 56), read_number(c + 64), read_number(c + 72), read_number(c + 80),
            )  # fmt: skip
            put(read_word(data + _ROW_LOSS) + 8 * row, loss)
            if read_int(data + _NISLAND) > 0:
                # The solver reads a copy that MuJoCo sorted by islands of touching bodies.
                put(read_word(data + _ISLAND_LOSS) + 8 * integer_at(data, _ISLAND_ROW, row), loss)


@compiled(_I(_I))
def _feels_load(model: int) -> int:
    """0 without a law, 2 if one depends on torques, else 1."""
    found = 0
    for i in range(read_int(model + _NNUMERIC)):
        if _is_law(model, i):
            found = max(found, 1)
            first = integer_at(model, _NUMERIC_ADR, i)
            for k in range(3, 9):
                if number_at(model, _NUMERIC_DATA, first + k) != 0.0:
                    found = 2
    return found


@compiled(types.boolean(_I))
def _has_other_rows(data: int) -> bool:
    """Whether anything but the friction of joints constrains this step."""
    frictions = read_int(data + _NF)
    if read_int(data + _NEFC) != frictions:
        return True
    return frictions > 0 and integer_at(data, _ROW_KIND, frictions - 1) != _FRICTION_DOF


def _law(model: int, data: int) -> None:
    """What MuJoCo calls: `mjcb_control` of the addresses of an `mjModel` and an `mjData`."""
    feels = _feels_load(model)
    if feels == 0:
        return
    _actuation(model, data)
    _acceleration(model, data)
    if feels == 2 and _has_other_rows(data):
        _write(model, data, _BALANCED)
        _solve(model, data)
        _write(model, data, _SOLVED)
    else:
        _write(model, data, _ALONE)


servo_law = cfunc(types.void(_I, _I), error_model="numpy")(_law)
