"""MuJoCo files of strangers: refused in one line before MuJoCo opens, makes or recurses into anything."""

import shutil

import pytest

from frasa_sysid.calibration import ModelError, load_model
from frasa_sysid.calibration.model_file import check_model_file

BODY = '<worldbody><body name="b"><freejoint/><geom size="0.1"/></body></worldbody>'
ARM = '<worldbody><body><joint name="j"/><geom size="0.1"/></body></worldbody>'


def model(tmp_path, inside, head=""):
    folder = tmp_path / "model"
    folder.mkdir()
    path = folder / "m.xml"
    path.write_text(f'{head}<mujoco model="m">{inside}</mujoco>')
    return path


@pytest.mark.parametrize(
    ("inside", "complaint"),
    [
        ('<include file="../../x.xml"/>', "<include> names ../../x.xml, outside"),
        ('<include file="/etc/passwd"/>', "outside"),
        ('<include file="m.xml"/>', "twice"),
        ('<include file="none.xml"/>', "not there"),
        ('<include file="."/>', "is a folder"),
        ('<asset><mesh file="../x.stl"/></asset>', "<mesh> names ../x.stl, outside"),
        ('<compiler meshdir="/dev"/><asset><mesh file="zero"/></asset>', "outside"),
        ('<asset><texture type="cube" fileup="../x.png"/></asset>', "<texture> names ../x.png, outside"),
        ('<asset><hfield file="../x.png"/></asset>', "<hfield> names"),
        ('<asset><model name="x" file="../x.xml"/></asset>', "<model> names ../x.xml, outside"),
        ('<size memory="900G"/>', "memory = 900G, expected at most 1024M"),
        ('<size nuser_body="2000000000"/>', "nuser_body = 2000000000, expected at most"),
        ('<size nkey="2000000000"/>', "nkey ="),
        ('<asset><hfield name="x" size="1 1 1 1" nrow="60000" ncol="60000"/></asset>', "nrow = 60000"),
        ('<asset><texture type="2d" builtin="flat" width="60000" height="60000"/></asset>', "width = 60000"),
        ('<custom><numeric name="x" size="2000000000"/></custom>', "size = 2000000000"),
        ('<worldbody><replicate count="100000000"><geom size="0.1"/></replicate></worldbody>', "100000 elements"),
        (
            "<worldbody>" + '<replicate count="100">' * 4 + '<geom size="1"/>' + "</replicate>" * 4 + "</worldbody>",
            "100000 elements",
        ),
        ('<worldbody><composite type="cable" count="100000000 1 1"/></worldbody>', "100000 elements"),
        ('<worldbody><body><flexcomp type="grid" count="9000 9000 9000"/></body></worldbody>', "100000 elements"),
        (f'{ARM}<actuator><position joint="j" delay="0.01" nsample="2000000000"/></actuator>', "nsample ="),
        ("<worldbody>" + "<body>" * 1000 + "</body>" * 1000 + "</worldbody>", "200 elements within each other"),
        ('<worldbody><replicate count="nan"/></worldbody>', "count = nan, expected finite numbers"),
    ],
)
def test_what_reaches_out_or_asks_for_too_much(tmp_path, inside, complaint):
    """Paths that climb out, sizes that fill memory, copies of copies, depth."""
    with pytest.raises(ModelError) as found:
        load_model(model(tmp_path, inside))
    assert complaint in str(found.value)
    assert str(found.value).isprintable()


@pytest.mark.parametrize(
    "head",
    [
        '<!DOCTYPE mujoco [<!ENTITY x SYSTEM "file:///etc/hostname">]>',
        '<!DOCTYPE mujoco [<!ENTITY a "xx"><!ENTITY b "&a;&a;">]>',
        '<!DOCTYPE mujoco SYSTEM "http://127.0.0.1:9/x.dtd">',
    ],
)
def test_entities(tmp_path, head):
    """No document type, so no entity that reads a file, a host, or grows."""
    with pytest.raises(ModelError, match="declares a document type"):
        load_model(model(tmp_path, BODY, head))


def test_what_is_no_model(tmp_path):
    """Other roots, other texts, nothing, a folder, a time step that no run would end with."""
    for content in (b"", b"hello", b"\xff\xfe<mujoco/>", b"<html/>", b"<mujoco>", b"<a>" * 1000):
        path = tmp_path / "m.xml"
        path.write_bytes(content)
        with pytest.raises(ModelError):
            load_model(path)
    with pytest.raises(ModelError, match="no model at"):
        load_model(tmp_path)
    with pytest.raises(ModelError, match="timestep is 1e-300 s, expected"):
        load_model(model(tmp_path, f'<option timestep="1e-300"/>{BODY}'))


def test_own_files_are_found(tmp_path, robot_model_dir, monkeypatch):
    """Folders of assets, models within models, includes beside it, and beside its folder in the working directory."""
    for name in ("nominal.xml", "calibrated.xml", "bench_pendulum.xml", "small_humanoid/small_humanoid.xml"):
        check_model_file(robot_model_dir / name)
    shutil.copy(robot_model_dir / "floor.xml", tmp_path)
    inside = '<compiler meshdir="meshes"/><include file="../floor.xml"/><asset><mesh file="a.stl"/></asset>'
    path = model(tmp_path, inside)
    with pytest.raises(ModelError, match="outside"):
        check_model_file(path)
    monkeypatch.chdir(tmp_path)
    check_model_file(path)
