"""Where MuJoCo keeps the fields that compiled code reads: byte offsets in `mjModel` and `mjData`.

The offsets follow from MuJoCo's own description of its structs (`mujoco.introspect`, made from the
headers of the installed version) by C's layout rules, and are then held against two models of
different sizes: every array, count and name must be found where the offsets say.
"""

import ctypes
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import mujoco
from mujoco.introspect import structs

from frasa_sysid.calibration.errors import ModelError

MODEL_FIELDS = (
    "nnumeric", "numeric_adr", "numeric_size", "numeric_data", "name_numericadr", "names",
    "ntuple", "tuple_adr", "tuple_size", "tuple_objtype", "tuple_objid", "name_tupleadr",
    "actuator_trntype", "actuator_trnid", "jnt_type", "jnt_dofadr", "dof_damping",
)  # fmt: skip
DATA_FIELDS = (
    "ne", "nf", "nefc", "nisland", "qvel", "qfrc_smooth", "qfrc_actuator", "qfrc_damper", "qfrc_constraint",
    "efc_type", "efc_id", "efc_frictionloss", "efc_force", "map_efc2iefc", "iefc_frictionloss",
)  # fmt: skip

# mjtNum is taken for a double here; a build of MuJoCo with floats fails the check of every array's place.
_PLAIN: dict[str, Any] = {
    "int": ctypes.c_int, "unsigned int": ctypes.c_uint, "char": ctypes.c_char, "float": ctypes.c_float,
    "double": ctypes.c_double, "mjtNum": ctypes.c_double, "mjtByte": ctypes.c_uint8, "mjtBool": ctypes.c_bool,
    "mjtSize": ctypes.c_int64, "size_t": ctypes.c_size_t, "uintptr_t": ctypes.c_size_t, "uint64_t": ctypes.c_uint64,
    "int64_t": ctypes.c_int64,
}  # fmt: skip
_PROBE = """<mujoco>
  <worldbody>{bodies}</worldbody>
  <equality><joint joint1="j0" joint2="j1"/></equality>
  <actuator>{motors}</actuator>
  <custom>{numbers}<tuple name="all">{elements}</tuple></custom>
</mujoco>"""


def offsets(struct: str, wanted: Iterable[str]) -> dict[str, int]:
    """Bytes from the start of a struct to each of its fields, checked against living models.

    Args:
        struct: `mjModel` or `mjData`.
        wanted: names of fields.

    Raises:
        ModelError: the installed MuJoCo describes its struct otherwise than it lays it out, or has no such field.
    """
    layout = _struct(structs.STRUCTS[struct].fields, struct)
    found = {}
    for name in wanted:
        if not hasattr(layout, name):
            raise ModelError(f"MuJoCo {mujoco.__version__} has no {struct}.{name}; the servo law needs it")
        found[name] = int(getattr(layout, name).offset)
    for joints in (2, 5):
        _check(struct, found, joints)
    return found


def library() -> ctypes.CDLL:
    """The MuJoCo library that the Python package has loaded.

    Raises:
        ModelError: it is not where the package should have it.
    """
    for path in sorted(Path(mujoco.__file__).parent.glob("*mujoco*")):
        if path.suffix == ".dll" or ".so." in path.name or path.suffix == ".dylib":
            return ctypes.CDLL(str(path))
    raise ModelError(f"no MuJoCo library beside {mujoco.__file__}; the servo law calls it from compiled code")


def _struct(declared: Iterable[Any], name: str) -> type[ctypes.Structure]:
    members = [(one.name, _ctype(one.type)) for one in declared]
    return type(name, (ctypes.Structure,), {"_fields_": members})


def _ctype(declared: Any) -> Any:  # noqa: ANN401 (MuJoCo's description of a C type, and ctypes' own)
    kind = type(declared).__name__
    if kind == "PointerType":
        return ctypes.c_void_p
    if kind == "ArrayType":
        inner = _ctype(declared.inner_type)
        for extent in reversed(declared.extents):
            inner = inner * extent
        return inner
    if hasattr(declared, "fields"):
        return _struct(declared.fields, "nested")
    if declared.name in structs.STRUCTS:
        return _struct(structs.STRUCTS[declared.name].fields, declared.name)
    if declared.name not in _PLAIN:
        raise ModelError(f"MuJoCo {mujoco.__version__} uses the unknown C type '{declared.name}'")
    return _PLAIN[declared.name]


def _check(struct: str, found: dict[str, int], joints: int) -> None:
    """Hold the offsets against a model with that many joints; an equality and a limit make its counts differ."""
    each = range(joints)
    body = (
        '<body><joint name="{0}" frictionloss="1" limited="{1}" range="10 20"/>'
        '<geom size="1" pos="0 0 1" contype="0" conaffinity="0"/></body>'
    )
    model = mujoco.MjModel.from_xml_string(
        _PROBE.format(
            bodies="".join(body.format(f"j{i}", "true" if i == 0 else "false") for i in each),
            motors="".join(f'<motor name="m{i}" joint="j{i}"/>' for i in each),
            numbers="".join(f'<numeric name="n{i}" size="{i + 1}"/>' for i in each),
            elements="".join(f'<element objtype="actuator" objname="m{i}"/>' for i in each),
        )
    )
    data = mujoco.MjData(model)
    mujoco.mj_fwdPosition(model, data)  # the callbacks of a user are not run by this
    owner = model if struct == "mjModel" else data
    types = {one.name: one.type for one in structs.STRUCTS[struct].fields}
    for name, offset in found.items():
        at = owner._address + offset
        if type(types[name]).__name__ != "PointerType":
            right = _ctype(types[name]).from_address(at).value == getattr(owner, name)
        elif name == "names":
            start = ctypes.c_size_t.from_address(at).value + int(model.name_tupleadr[0])
            right = ctypes.string_at(start, 4) == b"all\0"
        else:
            right = ctypes.c_size_t.from_address(at).value == getattr(owner, name).ctypes.data
        if not right:
            raise ModelError(f"MuJoCo {mujoco.__version__}: {struct}.{name} is not where its headers say")
