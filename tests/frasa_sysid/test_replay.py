"""The published model, read back and stepped by MuJoCo itself, does what the fit saw."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from frasa_sysid import stored_fit
from frasa_sysid.calibration import QualityError, load_model, servo_law
from frasa_sysid.commands.publish import publish_files
from frasa_sysid.fit import fit
from frasa_sysid.fit_record import Extras, save, to_json
from frasa_sysid.readers import read_log
from frasa_sysid.replay import replay
from frasa_sysid.servo import PUBLISHED_M4
from frasa_sysid.stand_in import stand_in

pytestmark = pytest.mark.usefixtures("law_as_before")


@pytest.fixture(scope="module")
def fitted(kit, robot_model_dir):
    """An M4 fit with a zero for each rig and a punch, near the published numbers; one run is held out."""
    runs = kit.runs(read_log(robot_model_dir.parent / "bench_logs" / "mx106.mcap")[1::5])
    problem = kit.problem(runs[:-1], (runs[-1],), law="m4", effects=("offsets", "punch"))
    friction = PUBLISHED_M4["mx106"].friction
    truth = {**{name: getattr(friction, name) for name in vars(friction)}, "kp": 26.0, "damping": 2.1, "delay": 0.0083}
    values = [truth.get(one.field, one.start) if not one.rig else 0.006 for one in problem.free]
    x = np.clip(problem.to_unit(np.array(values)), 0.0, 1.0)
    result = fit(problem, kit.session, {"mx106.mcap": "0" * 64}, evaluations=5, restarts=1, known=(x,))
    return result, stand_in(result, kit.session)


@pytest.fixture
def published(fitted, robot_model_dir, tmp_path):
    """Makes `calibrated.xml` of the fit, or of its stand-in, with a change to its numbers before."""
    for path in robot_model_dir.glob("*.xml"):
        if path.name != "calibrated.xml":
            shutil.copy(path, tmp_path)

    def make(as_law=None, **change):
        result, other = fitted
        save(tmp_path / "mx106.json", to_json(result, Extras("simulated", stand_in=other)))
        stored = stored_fit.load(tmp_path / "mx106.json")
        for field, factor in change.items():
            one = stored.parameters[f"mx106.{field}"]
            for key in stored_fit.NUMBERS:
                one[key] *= factor
            if field == "frictionloss":
                stored = replace(stored, law=replace(stored.law, coulomb=one["value"]))
            elif field not in ("kp", "damping", "armature"):
                stored = replace(stored, law=replace(stored.law, **{field: one["value"]}))
        publish_files([stored], tmp_path / "nominal.xml", tmp_path / "calibrated.xml", as_law=as_law)
        return load_model(tmp_path / "calibrated.xml")

    return make


def test_a_law_through_mujoco_and_the_callback(kit, fitted, published):
    """All runs, the held-out one too, within a milliradian: with the law in the model, not with its Coulomb part."""
    result, _ = fitted
    model = published()
    assert servo_law.law(model, "mx106").load_motor_stribeck > 0.01
    worst, count = replay(model, result, None, kit.session)
    assert 0.0 < worst < 1e-3
    assert count == len(result.problem.train) + len(result.problem.held_out) == 6 + 1


@pytest.mark.parametrize("change", [{"kp": 1.02}, {"damping": 1.02}, {"stribeck": 1.5}, {"frictionloss": 1.5}])
def test_a_model_that_says_something_else_is_found_out(kit, fitted, published, change):
    if "frictionloss" in change and fitted[0].problem.servo_values(fitted[0].values).frictionloss < 1e-3:
        change = {"load_motor_stribeck": 1.3}
    with pytest.raises(QualityError, match=r"replays the logs .* mrad away from the fit; allowed is 1\.0 mrad"):
        replay(published(**change), fitted[0], None, kit.session)


def test_the_stand_in_through_mujoco(kit, fitted, published):
    """M1 needs no callback, and is held to a tenth of a milliradian; against the law it stands for it would fail."""
    result, other = fitted
    model = published("m1")
    assert servo_law.law(model, "mx106") is None
    worst, _ = replay(model, result, other, kit.session)
    assert worst < 1e-4
    with pytest.raises(QualityError):
        replay(model, result, None, kit.session)
    with pytest.raises(QualityError, match=r"allowed is 0\.1 mrad"):
        replay(
            published("m1"),
            result,
            replace(other, values=replace(other.values, kp=1.001 * other.values.kp)),
            kit.session,
        )
