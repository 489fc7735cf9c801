"""Bodies, joints, shapes and sites of the nominal model against the source's tables."""

import mujoco
import numpy as np
import pytest

EXACT = {"rtol": 0, "atol": 1e-12}


def floats(row, *names):
    return np.array([float(row[name]) for name in names])


def quat(row, prefix="quat"):
    q = floats(row, *(f"{prefix}_{axis}" for axis in "wxyz"))
    return q / np.linalg.norm(q)


def check_pose(row, pos, orientation):
    np.testing.assert_allclose(pos, floats(row, "pos_x", "pos_y", "pos_z"), **EXACT)
    np.testing.assert_allclose(orientation, quat(row), **EXACT)


def test_bodies(nominal, table):
    """Order, tree, frame, mass, centre of mass and principal inertia of every body are the table's."""
    rows = table("bodies")
    alias = {row["name"]: row["alias"] for row in rows} | {"world": "world"}
    assert nominal.nbody == len(rows) + 1
    for i, row in enumerate(rows, start=1):
        assert nominal.body(i).name == row["alias"]
        assert nominal.body(nominal.body_parentid[i]).name == alias[row["parent"]]
        check_pose(row, nominal.body_pos[i], nominal.body_quat[i])
        np.testing.assert_allclose(nominal.body_mass[i], float(row["mass"]), **EXACT)
        np.testing.assert_allclose(nominal.body_inertia[i], floats(row, *(f"inertia_{k}" for k in (1, 2, 3))), **EXACT)
        np.testing.assert_allclose(nominal.body_ipos[i], floats(row, "com_x", "com_y", "com_z"), **EXACT)
        if row["inertia_source"] == "explicit":
            np.testing.assert_allclose(nominal.body_iquat[i], quat(row, "iquat"), **EXACT)


def test_joints(nominal, table):
    """Type, body, axis, anchor, absence of limits and passive numbers of every joint are the table's."""
    rows = table("joints")
    assert nominal.njnt == len(rows)
    for i, row in enumerate(rows):
        assert nominal.joint(i).name == row["name"]
        assert nominal.body(nominal.jnt_bodyid[i]).name == row["body_alias"]
        assert nominal.jnt_limited[i] == int(row["limited"] or 0)
        if row["type"] == "free":
            assert nominal.jnt_type[i] == mujoco.mjtJoint.mjJNT_FREE
            continue
        assert nominal.jnt_type[i] == mujoco.mjtJoint.mjJNT_HINGE
        np.testing.assert_allclose(nominal.jnt_axis[i], floats(row, "axis_x", "axis_y", "axis_z"), **EXACT)
        np.testing.assert_allclose(nominal.jnt_pos[i], floats(row, "pos_x", "pos_y", "pos_z"), **EXACT)
        dof = nominal.jnt_dofadr[i]
        for field in ("damping", "armature", "frictionloss"):
            assert getattr(nominal, f"dof_{field}")[dof] == float(row[field])


def test_joint_axes_in_the_trunk(nominal, table):
    """With all joints at 0 every axis and anchor is where the table puts it in trunk axes."""
    data = mujoco.MjData(nominal)
    mujoco.mj_kinematics(nominal, data)
    for i, row in enumerate(table("joints")[1:], start=1):
        axis = floats(row, *(f"world_axis_{k}_at_zero" for k in "xyz"))
        anchor = floats(row, *(f"anchor_{k}_at_zero" for k in "xyz"))
        np.testing.assert_allclose(data.xaxis[i], axis, rtol=0, atol=2e-6)
        np.testing.assert_allclose(data.xanchor[i], anchor, rtol=0, atol=2e-7)


def test_shapes(nominal, table):
    """Type, pose, size, friction, contact filter and softness of every shape are the table's."""
    rows = table("geoms")
    assert nominal.ngeom == len(rows)
    for i, row in enumerate(rows):
        geom = nominal.geom(i)
        assert geom.name == row["label"]
        assert nominal.body(nominal.geom_bodyid[i]).name == row["body_alias"]
        assert nominal.geom_type[i] == getattr(mujoco.mjtGeom, f"mjGEOM_{row['type'].upper()}")
        check_pose(row, geom.pos, geom.quat)
        size = [float(row[f"size_{k}"] or 0) for k in (1, 2, 3)]
        np.testing.assert_allclose(geom.size, size, **EXACT)
        np.testing.assert_allclose(geom.friction, floats(row, "friction_slide", "friction_spin", "friction_roll"))
        np.testing.assert_allclose(geom.solref, floats(row, "solref_1", "solref_2"))
        np.testing.assert_allclose(geom.solimp, floats(row, *(f"solimp_{k}" for k in range(1, 6))))
        for field in ("contype", "conaffinity", "condim", "group", "priority", "margin", "gap"):
            assert getattr(nominal, f"geom_{field}")[i] == float(row[field]), (row["label"], field)


def test_sites(nominal, table):
    """Name, body and pose of every site are the table's."""
    rows = table("sites")
    assert nominal.nsite == len(rows)
    for row in rows:
        i = nominal.site(row["name"]).id
        assert nominal.body(nominal.site_bodyid[i]).name == row["body_alias"]
        check_pose(row, nominal.site_pos[i], nominal.site_quat[i])


def test_no_excludes_or_pairs(nominal, table):
    """Nothing but parent and child is kept from colliding."""
    assert nominal.nexclude == len(table("excludes")) == 0
    assert nominal.npair == 0


@pytest.mark.parametrize("name", ["equalities", "tendons", "mesh_geoms"])
def test_nothing_else(nominal, table, name):
    """The model has no equality, tendon or mesh, as the source."""
    option = {row["option"]: row["value"] for row in table("options")}
    count = {"equalities": nominal.neq, "tendons": nominal.ntendon, "mesh_geoms": nominal.nmesh}
    assert count[name] == int(option[name])
