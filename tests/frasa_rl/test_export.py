"""What leaves is complete, says what a robot must know, and acts as the trainer does in every runtime."""

import json
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
import yaml

from frasa_rl.cli import main
from frasa_rl.config import Joint, Names, Task
from frasa_rl.deployment import deployment, metadata
from frasa_rl.export import check_published, publish
from frasa_rl.observation import bounds
from frasa_rl.policy import Policy
from frasa_rl.runtime import Network, Runtime, read_weights
from frasa_sysid.calibration import QualityError, load_model, model_sha256

onnx = pytest.importorskip("onnx", reason="the extra `export`")

TASK = Task()


def seen(count=1000):
    """What a robot may see: joints anywhere, all turning as fast as commands do."""
    rng = np.random.default_rng(2)
    scale = np.repeat([2.0, 6.0, 2.0, 1.5, 5.0, 1.0], [5, 5, 5, 1, 1, 5])
    return rng.uniform(-scale, scale, (count, 22)).astype(np.float32)


@pytest.fixture(scope="module")
def learner():
    """A learner of CrossQ as the paper has it, with statistics and scales as after a long training."""
    pytest.importorskip("sb3_contrib")
    import torch

    from frasa_rl.learner import build
    from frasa_rl.settings import PRESETS

    settings = replace(PRESETS["paper"], envs=1, buffer=100)
    own = build(settings, bounds(TASK), len(TASK.joints), "cpu")
    model = own.model
    torch.manual_seed(0)
    with torch.no_grad():
        for name, tensor in model.actor.state_dict().items():
            if name.endswith(("ra_mean", "bias")):
                tensor.copy_(0.5 * torch.randn_like(tensor))
            elif name.endswith("ra_var"):
                tensor.copy_(torch.exp(torch.randn_like(tensor)))
            elif name.endswith("scale"):
                tensor.copy_(1.0 + 0.3 * torch.randn_like(tensor))
    return own


def test_all_runtimes_agree_with_the_trainer(learner, nominal, tmp_path, random_policy):
    """torch, the plain policy, the robot's runtime and onnxruntime: within 1e-5 on 1000 observations."""
    onnxruntime = pytest.importorskip("onnxruntime", reason="the extra `export`")
    observations = seen()
    expected, _ = learner.model.predict(observations, deterministic=True)
    assert np.ptp(expected) > 1.0
    policy = learner.actor().policy(random_policy(4).run)
    publish(policy, deployment(policy.run, TASK, nominal), tmp_path)
    runtime = Runtime.load(tmp_path)
    session = onnxruntime.InferenceSession(tmp_path / "policy.onnx", providers=["CPUExecutionProvider"])
    found = {
        "policy": policy.act(observations),
        "one by one": np.stack([policy.act(one) for one in observations]),
        "runtime": np.stack([runtime.act(one).copy() for one in observations]),
        "onnxruntime": session.run(None, {"obs": observations})[0],
        "onnxruntime, one by one": np.concatenate([session.run(None, {"obs": one[None]})[0] for one in observations]),
    }
    if find_spec("openvino"):
        found["OpenVINO"] = with_openvino(tmp_path / "policy.onnx")(observations)[0]
    for name, actions in found.items():
        np.testing.assert_allclose(actions, expected, atol=1e-5, err_msg=name)


def with_openvino(path):
    import openvino

    # Without the hint it computes in bfloat16 where the processor can, and is off by 1e-2.
    return openvino.Core().compile_model(path, "CPU", {"INFERENCE_PRECISION_HINT": "f32"})


def test_openvino_agrees(random_policy, nominal, tmp_path):
    """OpenVINO reads the same file, for one observation and for many, where it is installed."""
    pytest.importorskip("openvino", reason="the extra `openvino`")
    policy, observations = random_policy(384, 256), seen()
    publish(policy, deployment(policy.run, TASK, nominal), tmp_path)
    act, expected = with_openvino(tmp_path / "policy.onnx"), policy.act(observations)
    for count in (1, 1000):
        np.testing.assert_allclose(act(observations[:count])[0], expected[:count], atol=1e-5)


def test_the_onnx_file_is_old_enough_and_described(nominal, tmp_path, random_policy):
    """Gemm, Relu, Tanh of opset 13, any batch, and mjlab's keys beside ours in the metadata."""
    policy = random_policy(8, 6)
    publish(policy, deployment(policy.run, TASK, nominal), tmp_path)
    model = onnx.load(tmp_path / "policy.onnx")
    assert [one.op_type for one in model.graph.node] == ["Gemm", "Relu", "Gemm", "Relu", "Gemm", "Tanh"]
    assert ([one.version for one in model.opset_import], model.ir_version) == ([13], 8)
    for tensor, name, size in ((model.graph.input[0], "obs", 22), (model.graph.output[0], "actions", 5)):
        dims = tensor.type.tensor_type.shape.dim
        assert (tensor.name, dims[0].dim_param, dims[1].dim_value) == (name, "batch", size)
    said = {one.key: one.value for one in model.metadata_props}
    lists = {name: value.split(",") for name, value in said.items()}
    assert lists["joint_names"][:2] == ["left_elbow", "right_elbow"]
    for name in ("stiffness", "damping", "mirror", "torque_limit", "command_low", "command_high", "command_delay"):
        assert len([float(one) for one in lists[f"joint_{name}"]]) == 10, name
    assert lists["joint_stiffness"][4] == "21.0"
    assert lists["joint_actions"] == [str(index) for index in (0, 0, 1, 1, 2, 2, 3, 3, 4, 4)]
    np.testing.assert_allclose([float(one) for one in lists["default_joint_pos"][6:8]], np.radians(79.0))
    assert lists["observation_names"] == ["position", "velocity", "command", "pitch", "pitch_rate", "previous_action"]
    assert lists["observation_terms_clip"][1] == "-30;30"
    assert {len(lists[f"observation_terms_{one}"]) for one in ("scale", "history_length", "flatten_history_dim")} == {6}
    assert (said["action_type"], said["control_dt"], said["control_rates_hz"]) == ("joint_rate", "0.05", "20..100")
    assert (said["calibration_id"], said["seed"], len(said["model_xml_sha256"])) == ("none (nominal)", "3", 64)
    assert json.loads(said["frasa_deploy"]) == json.loads((tmp_path / "deploy.json").read_text())


def test_the_description_is_the_models(calibrated):
    """Gains, limits and delays are those of the compiled model, joint by joint."""
    model = load_model(calibrated)
    deploy = deployment({"calibration_id": "c0ffee"}, TASK, calibrated)
    assert len(deploy["servos"]) == model.nu
    for one in deploy["servos"]:
        actuator = model.actuator(one["joint"])
        np.testing.assert_allclose([one["command_low_rad"], one["command_high_rad"]], actuator.ctrlrange, rtol=1e-8)
        np.testing.assert_allclose([one["force_low"], one["force_high"]], actuator.forcerange, rtol=1e-8)
        assert one["kp"] == pytest.approx(actuator.gainprm[0])
        assert one["damping"] == pytest.approx(model.joint(one["joint"]).damping[0])
    ages = {one["name"]: one.get("delay_s") for one in deploy["observation"]}
    for name, sensor in (("velocity", "left_knee.velocity"), ("pitch_rate", "measured_gyro")):
        assert ages[name] == pytest.approx(model.sensor_delay[model.sensor(sensor).id])
    assert deploy["model"]["sha256"] == model_sha256(model)
    assert (deploy["calibration_id"], deploy["model"]["calibration_id"]) == ("c0ffee", "c0ffee")
    moved = {side for one in deploy["joints"] for side in (one["left"], one["right"])}
    assert moved | set(deploy["held"]) == {one["joint"] for one in deploy["servos"]}
    assert not moved & set(deploy["held"])


def test_a_joint_on_the_midline_stands_once():
    """Another robot: one waist, moved by one action; all lists of joints are as long as their names."""
    path = Path(__file__).with_name("box_robot.xml")
    names = Names("torso", "ground", "{}", "{}", None, None, None, None, None)
    task = Task(joints=(Joint("neck", 0.0),), target_pitch_deg=0.0, held_deg=(), names=names)
    deploy = {**deployment({}, task, path), "frasa_version": "0"}
    said = metadata(deploy)
    assert (said["joint_names"], said["joint_actions"], said["held_joint_names"]) == ("neck", "0", "")
    assert [one["left"] == one["right"] == "neck" for one in deploy["joints"]] == [True]


def test_the_hash_is_the_runs(nominal):
    """A run and an export speak of a model by the same number."""
    plan = pytest.importorskip("frasa_rl.plan")
    said = plan.describe(plan.Plan(nominal, nominal.parent / "run", plan.Settings(), steps=1))["model_sha256"]
    assert said == deployment({}, TASK, nominal)["model"]["sha256"] == model_sha256(load_model(nominal))


def test_new_weights_take_old_exports_away(nominal, tmp_path, random_policy):
    """Saving other weights leaves no ONNX file or description of those before; without onnx the rest is written."""
    policy = random_policy(8)
    publish(policy, deployment(policy.run, TASK, nominal), tmp_path)
    names = {"deploy.json", "policy.onnx", "run.yaml", "weights.safetensors"}
    assert {one.name for one in tmp_path.iterdir()} == names
    random_policy(6).save(tmp_path)
    assert {one.name for one in tmp_path.iterdir()} == {"run.yaml", "weights.safetensors"}


def test_without_onnx_the_rest_is_published(nominal, tmp_path, monkeypatch, capsys, random_policy):
    """A training without the package leaves everything else; the command says what is missing."""
    policy = random_policy(8, run={"model": str(nominal)})
    policy.save(tmp_path / "p")
    monkeypatch.setattr("frasa_rl.export.find_spec", lambda name: None)
    monkeypatch.setattr("frasa_rl.commands.export.find_spec", lambda name: None if name == "onnx" else True)
    publish(policy, deployment(policy.run, TASK, nominal), tmp_path / "out")
    assert {one.name for one in (tmp_path / "out").iterdir()} == {"deploy.json", "run.yaml", "weights.safetensors"}
    assert Runtime.load(tmp_path / "out").period_s == 0.05
    assert main(["export", str(tmp_path / "p")]) == 2
    assert "frasa[export]" in capsys.readouterr().err


def test_files_that_do_not_act_alike_are_not_passed_on(nominal, tmp_path, random_policy):
    """The export tries its own files and fails when one acts otherwise."""
    policy = random_policy(8)
    deploy = deployment(policy.run, TASK, nominal)
    publish(policy, deploy, tmp_path)
    assert check_published(policy, deploy, tmp_path)["runtime"] < 1e-5
    (weight, bias), last = policy.layers
    with pytest.raises(QualityError, match="differs by"):
        check_published(replace(policy, layers=((weight + np.float32(1e-3), bias), last)), deploy, tmp_path)


def test_weights_are_what_others_read(nominal, tmp_path, random_policy):
    """The safetensors library reads our file, our reader reads the library's, and notes stay with the weights."""
    from safetensors import safe_open
    from safetensors.numpy import save_file

    policy = random_policy(8)
    publish(policy, deployment(policy.run, TASK, nominal), tmp_path)
    with safe_open(tmp_path / "weights.safetensors", "numpy") as file:
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - it is no mapping
        assert json.loads(file.metadata()["frasa_deploy"])["schema"] == "frasa.deploy/1"
    save_file(tensors, tmp_path / "again.safetensors")
    layers, _ = read_weights(tmp_path / "again.safetensors")
    np.testing.assert_array_equal(Network(layers).act(np.ones(22)), Network(policy.layers).act(np.ones(22)))


@pytest.fixture
def trained(nominal, tmp_path, random_policy):
    """The folder of a run on the nominal model."""
    run = {"model": str(nominal), "model_sha256": model_sha256(load_model(nominal))}
    run["versions"] = {"mujoco": __import__("mujoco").__version__}
    random_policy(16, run=run).save(tmp_path / "run" / "policy")
    return tmp_path / "run"


def test_the_command_writes_a_folder(trained, capsys):
    """export of a run: four files in a folder of their own that load as a policy and as a runtime, told as JSON."""
    assert main(["export", str(trained), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["schema"] == "frasa.export/1"
    assert said["files"] == ["deploy.json", "policy.onnx", "run.yaml", "weights.safetensors"]
    assert said["rates_hz"] == [20.0, 100.0]
    assert max(said["agreement"].values()) < 1e-5
    folder = trained / "export"
    assert Policy.load(folder).run == Policy.load(trained).run
    assert Runtime.load(folder, 100).joints[3] == ("left_knee", "right_knee")
    deploy = json.loads((folder / "deploy.json").read_text())
    assert deploy["trained"]["origin"] == "run run"


def test_gains_of_another_robot_are_not_written(trained, model_copy, calibrated, tmp_path, capsys):
    """Another model than the policy's is refused, or named, or meant."""
    words = ["export", str(trained), "--out", str(tmp_path / "out"), "--model"]
    assert main([*words, str(calibrated)]) == 3
    assert "c0ffee" in capsys.readouterr().err
    model_copy.write_text(model_copy.read_text().replace('impratio="1"', 'impratio="2"'))
    assert main([*words, str(model_copy)]) == 3
    assert "not the model the policy was trained on" in capsys.readouterr().err
    run = Policy.load(trained).run
    (trained / "policy" / "run.yaml").write_text(yaml.safe_dump({**run, "versions": {"mujoco": "3.0"}}))
    assert main([*words, str(model_copy)]) == 0
    assert "with MuJoCo 3.0" in capsys.readouterr().err
    assert main([*words, str(calibrated), "--allow-other-model"]) == 0
    deploy = json.loads((tmp_path / "out" / "deploy.json").read_text())
    assert (deploy["calibration_id"], deploy["model"]["calibration_id"]) == (None, "c0ffee")
    assert main(["export", str(trained), "--task", "any.yaml"]) == 2
    assert "--task" in capsys.readouterr().err


def test_a_policy_trained_in_the_published_environment_has_one_rate(nominal, random_policy, tmp_path):
    """Its histories are the environment's: what runs it at 100 Hz would feed it other ones than in training."""
    folder, other = tmp_path / "compat", Task(compat="frasa2024")
    publish(random_policy(16), deployment({}, other, nominal), folder)
    control = json.loads((folder / "deploy.json").read_text())["control"]
    assert control["lowest_hz"] == control["highest_hz"] == 20.0
