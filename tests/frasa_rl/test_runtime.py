"""The robot's runtime does what the evaluation does, at any rate, and takes no file that is not exactly right."""

import json
import shutil
import struct
import subprocess
import sys

import numpy as np
import pytest

import frasa_rl.runtime
from frasa_rl.batch import Batch
from frasa_rl.config import Task
from frasa_rl.controllers import PolicyController
from frasa_rl.deployment import deployment
from frasa_rl.export import publish
from frasa_rl.policy import Policy, PolicyError
from frasa_rl.readings import read, truth
from frasa_rl.robot import pitch_of
from frasa_rl.runtime import DeployError, Network, Runtime
from frasa_rl.starts import StartMaker
from frasa_rl.task_model import build_model

TASK = Task()


@pytest.fixture(scope="module")
def policy(random_policy):
    return random_policy(64, 48)


@pytest.fixture(scope="module")
def exported(policy, robot_model_dir, tmp_path_factory):
    folder = tmp_path_factory.mktemp("exported")
    publish(policy, deployment(policy.run, TASK, robot_model_dir / "nominal.xml"), folder)
    return folder


@pytest.fixture
def copied(exported, tmp_path):
    return shutil.copytree(exported, tmp_path / "copied")


class World:
    """A robot in the task's physics."""

    def __init__(self, path, rate_hz):
        model = build_model(path, TASK)
        self.batch = Batch(model, TASK, 1, 1, 1.0 / rate_hz)
        self.batch.put(0, StartMaker(model, TASK, None, randomize=False).make([np.random.default_rng(5)], ["any"])[0])

    def steer(self, runtime):
        """One decision of a runtime that gets readings and gives commands, and nothing else."""
        batch, sim = self.batch, self.batch.sim
        seen = read(batch.robot, sim, batch.now, batch._ages)
        runtime.step(seen.positions[0], seen.velocities[0], seen.pitch[0], seen.pitch_rate[0])
        steps = batch._ramp.size
        controls = np.repeat(batch.held[:, None], steps, axis=1)
        for index in range(steps):
            controls[0, index, batch.robot.actuators] = runtime.between((index + 1) / steps)
        sim.advance(controls)
        batch.now = truth(batch.robot, sim)


@pytest.mark.parametrize("rate", [20, 100])
def test_the_runtime_does_what_the_evaluation_does(policy, exported, nominal, rate):
    """Two same robots, one told by the evaluation, one by the runtime from readings alone, go the same way."""
    theirs, ours = World(nominal, rate), World(nominal, rate)
    runtime, controller = Runtime.load(exported, rate), PolicyController(policy, "p")
    start = ours.batch.sim.ctrl[0][ours.batch.robot.actuators]
    runtime.start(start)
    moved = 0.0
    for _ in range(rate):  # a second: from then on contacts tell apart what is not
        seen = theirs.batch.observation
        theirs.batch.act(controller.act(seen).astype(np.float64))
        ours.steer(runtime)
        np.testing.assert_allclose(runtime.observation, seen[0], atol=1e-5)
        np.testing.assert_allclose(runtime.between(1.0)[:, 0], theirs.batch.commands[0], atol=1e-5)
        np.testing.assert_allclose(ours.batch.sim.state, theirs.batch.sim.state, atol=1e-5)
        moved = max(moved, float(np.abs(runtime.between(1.0) - start).max()))
    assert moved > 0.5
    for one in (theirs, ours):
        one.batch.close()


def test_both_sides_are_mirrored(exported, nominal, copied):
    """A joint whose right side needs the opposite number gets it, is read so, and is kept inside its limits."""
    deploy = json.loads((copied / "deploy.json").read_text())
    deploy["joints"][0].update(mirror=-1, command_low_rad=-0.1, command_high_rad=0.1)
    (copied / "deploy.json").write_text(json.dumps(deploy))
    runtime = Runtime.load(copied)
    assert runtime.joints[0] == ("left_elbow", "right_elbow")
    assert runtime.held["left_shoulder_roll"] == pytest.approx(np.radians(-5.0))
    runtime.start(np.tile([0.05, -0.05], (5, 1)))
    angles = np.tile([0.3, -0.1], (5, 1))
    commands = runtime.step(angles, 10.0 * angles, 0.1, 0.2).copy()
    np.testing.assert_allclose(runtime.observation[[0, 1, 5, 6, 10, 11]], [0.2, 0.1, 2.0, 1.0, 0.05, 0.0], atol=1e-6)
    np.testing.assert_allclose(runtime.observation[15:17], [0.1, 0.2], atol=1e-6)
    for _ in range(20):
        commands = runtime.step(angles, angles, 0.1, 0.2)
        assert commands[0, 0] == -commands[0, 1]
        assert abs(commands[0, 0]) <= 0.1
        assert (commands[1:, 0] == commands[1:, 1]).all()


@pytest.mark.parametrize(("rate", "shares"), [(20, [1.0]), (30, [1 / 3, 2 / 3]), (100, [0.2] * 5)])
def test_the_previous_action_is_the_mean_over_the_trained_period(exported, rate, shares):
    """Whatever the rate: where it does not divide the period, only a part of the oldest counts."""
    runtime = Runtime.load(exported, rate)
    runtime.start(np.zeros((5, 2)))
    applied = []
    for _ in range(6):
        runtime.step(np.zeros((5, 2)), np.zeros((5, 2)), 0.1, 0.0)
        expected = np.array(shares) @ np.array(([[0.0] * 5] * 5 + applied)[-len(shares) :])
        np.testing.assert_allclose(runtime.observation[17:], expected, atol=1e-6)
        applied.append(runtime.act(runtime.observation).tolist())


@pytest.mark.parametrize("rate", [20, 100])
@pytest.mark.parametrize("bad", [np.nan, np.inf, "shape"])
def test_a_refused_reading_moves_nothing(exported, rate, bad):
    """The goals along the ramp stay where the last one ended, for as long as readings are refused; then it goes on."""
    runtime = Runtime.load(exported, rate)
    runtime.start(np.full((5, 2), 0.3))
    good, broken = np.full((5, 2), 0.2), np.full((5, 2), 0.2)
    broken[2, 1] = 0.0 if bad == "shape" else bad
    for _ in range(3):
        last = runtime.step(good, good, 0.1, 0.2).copy()
    assert np.abs(runtime.between(0.0) - last).max() > 1e-3
    for _ in range(7):
        with pytest.raises(ValueError, match="reading"):
            runtime.step(broken[:4] if bad == "shape" else broken, good, 0.1, 0.2)
        for share in (0.0, 0.2, 1.0):
            np.testing.assert_array_equal(runtime.between(share), last)
    runtime.step(good, good, 0.1, 0.2)
    assert (runtime.observation[17:] == 0.0).all(), "what the policy did last, it did before readings were refused"
    np.testing.assert_array_equal(runtime.between(0.0), last)


def test_sides_that_are_apart_come_together_at_the_rate_limit(exported):
    """No joint jumps at the start, however the robot lies, and after a while both sides have one command."""
    runtime = Runtime.load(exported, 100)
    lies = np.array([[1.0, -1.0], [0.4, 0.1], [0.0, 0.0], [5.0, 5.0], [-0.2, 0.7]])
    runtime.start(lies)
    travel = runtime.deploy["action"]["rate_limit_rad_s"] / 100
    np.testing.assert_allclose(runtime.between(0.0), lies, atol=1e-12)
    before = lies
    for _ in range(100):
        commands = runtime.step(before, np.zeros((5, 2)), 0.1, 0.0).copy()
        np.testing.assert_allclose(runtime.between(0.0), before, atol=1e-12)
        np.testing.assert_allclose(runtime.between(1.0), commands, atol=1e-12)
        assert np.abs(commands - before).max() <= travel + 1e-12
        before = commands
    assert (commands[:, 0] == commands[:, 1]).all()
    assert runtime.deploy["joints"][3]["command_high_rad"] >= commands[3, 0]


def test_a_step_before_the_start_is_refused(exported):
    """Nobody told it where the robot is: its first goals would be somewhere else."""
    runtime = Runtime.load(exported)
    with pytest.raises(RuntimeError, match="start"):
        runtime.step(np.zeros((5, 2)), np.zeros((5, 2)), 0.0, 0.0)
    with pytest.raises(RuntimeError, match="start"):
        runtime.between(1.0)


@pytest.mark.parametrize("rate", [19.0, 101.0, float("nan"), float("inf"), 0.0, -20.0])
def test_a_rate_it_was_not_measured_at_is_refused(exported, rate):
    """Slower than in training, or faster than the protocol tries, or no rate at all."""
    with pytest.raises(DeployError, match="20 to 100"):
        Runtime.load(exported, rate)


def test_readings_that_are_no_numbers_move_nothing(exported):
    """A sensor that fails leaves the commands where they are, and the next good reading goes on."""
    runtime = Runtime.load(exported)
    runtime.start(np.full((5, 2), 0.1))
    zeros = np.zeros((5, 2))
    bad = zeros.copy()
    bad[2, 1] = np.nan
    for readings in ((bad, zeros, 0.0, 0.0), (zeros, zeros, np.inf, 0.0), (zeros[:4], zeros, 0.0, 0.0)):
        with pytest.raises(ValueError, match="reading"):
            runtime.step(*readings)
        np.testing.assert_array_equal(runtime.between(1.0), np.full((5, 2), 0.1))
    assert np.isfinite(runtime.step(zeros, zeros, 0.0, 0.0)).all()
    for wrong in (np.zeros((5,)), np.full((5, 2), np.nan)):
        with pytest.raises(ValueError, match="commands of shape"):
            runtime.start(wrong)
    with pytest.raises(ValueError, match="expected"):
        runtime.act(np.zeros(1))


def test_pitch_is_the_simulations():
    """The helper for a robot's own orientation is what the simulation uses."""
    for quaternion in np.random.default_rng(0).normal(size=(20, 4)):
        assert frasa_rl.runtime.pitch_of(*quaternion) == pytest.approx(float(pitch_of(quaternion)))


def test_the_file_needs_numpy_and_nothing_else(exported, tmp_path):
    """Copied to a place without this project, the one file runs a policy; no package but numpy is imported."""
    shutil.copy(frasa_rl.runtime.__file__, tmp_path / "runtime.py")
    script = (
        "import sys, json; before = set(sys.modules); sys.path.insert(0, '.'); import runtime; import numpy as n;"
        f"r = runtime.Runtime.load({str(exported)!r}); r.start(n.zeros((5, 2)));"
        "print(json.dumps([r.step(n.zeros((5, 2)), n.zeros((5, 2)), 0.1, 0.0).tolist(),"
        "sorted({m.split('.')[0] for m in set(sys.modules) - before} - set(sys.stdlib_module_names))]))"
    )
    done = subprocess.run(
        [sys.executable, "-I", "-c", script], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    commands, modules = json.loads(done.stdout)
    assert modules == ["numpy", "runtime"]
    runtime = Runtime.load(exported)
    runtime.start(np.zeros((5, 2)))
    np.testing.assert_array_equal(runtime.step(np.zeros((5, 2)), np.zeros((5, 2)), 0.1, 0.0), commands)


def tensors_file(header, data=b"", size=None):
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    return struct.pack("<Q", len(text) if size is None else size) + text + data


def entry(shape, begin, end, dtype="F32"):
    return {"dtype": dtype, "shape": shape, "data_offsets": [begin, end]}


ONE = {"layer0.weight": entry([1, 2], 0, 8), "layer0.bias": entry([1], 8, 12)}
NUMBERS = np.arange(3, dtype="<f4").tobytes()
HOSTILE = {
    "empty": b"",
    "short": b"\x01\x02",
    "a pickle": b"\x80\x04\x95" + b"cos\nsystem\n(S'true'\ntR.",
    "huge header": tensors_file(ONE, NUMBERS, size=2**63),
    "header beyond the file": tensors_file(ONE, b"", size=10_000),
    "header of spaces": tensors_file(b" " * (2 << 20), NUMBERS),
    "not UTF-8": tensors_file(b"{\xff}", NUMBERS),
    "a list": tensors_file([1], NUMBERS),
    "deep": tensors_file(b"[" * 100_000, NUMBERS),
    "no tensors": tensors_file({"__metadata__": {}}),
    "a name twice": tensors_file(b'{"layer0.bias": 1, "layer0.bias": 2}', NUMBERS),
    "a path": tensors_file({"../../layer0.weight": ONE["layer0.weight"], "layer0.bias": ONE["layer0.bias"]}, NUMBERS),
    "no first layer": tensors_file({"layer1.weight": entry([1, 2], 0, 8), "layer1.bias": entry([1], 8, 12)}, NUMBERS),
    "entry is a number": tensors_file({**ONE, "layer0.bias": 5}, NUMBERS),
    "wrong type": tensors_file({**ONE, "layer0.bias": entry([1], 8, 12, "I32")}, NUMBERS),
    "another size": tensors_file({**ONE, "layer0.bias": entry([2], 8, 12)}, NUMBERS),
    "huge shape": tensors_file({**ONE, "layer0.weight": entry([2**40, 2**40], 0, 8)}, NUMBERS),
    "shape of no numbers": tensors_file({**ONE, "layer0.weight": entry([0, 2], 0, 0)}, NUMBERS),
    "shape of flags": tensors_file({**ONE, "layer0.bias": entry([True], 8, 12)}, NUMBERS),
    "negative": tensors_file({**ONE, "layer0.bias": entry([1], -4, 0)}, NUMBERS),
    "backwards": tensors_file({**ONE, "layer0.bias": entry([1], 12, 8)}, NUMBERS),
    "no offsets": tensors_file({**ONE, "layer0.bias": {"dtype": "F32", "shape": [1]}}, NUMBERS),
    "overlap": tensors_file({**ONE, "layer0.bias": entry([1], 4, 8)}, NUMBERS[:8]),
    "hole": tensors_file({**ONE, "layer0.bias": entry([1], 12, 16)}, NUMBERS + NUMBERS[:4]),
    "beyond the end": tensors_file(ONE, NUMBERS[:8]),
    "left over": tensors_file(ONE, NUMBERS + NUMBERS[:4]),
    "not finite": tensors_file(ONE, np.array([1, np.nan, 2], dtype="<f4").tobytes()),
    "shapes do not follow": tensors_file(
        {**ONE, "layer1.weight": entry([1, 3], 12, 24), "layer1.bias": entry([1], 24, 28)}, NUMBERS * 2 + NUMBERS[:4]
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_weights_are_refused(copied, name):
    """Whatever a stranger's file says of itself, both readers end in one line, without much memory."""
    (copied / "weights.safetensors").write_bytes(HOSTILE[name])
    for load, error in ((Runtime.load, DeployError), (Policy.load, PolicyError)):
        with pytest.raises(error) as said:
            load(copied)
        assert "\n" not in str(said.value)
        assert len(str(said.value)) < 500


def test_a_pipe_is_no_file(copied):
    """What is not a plain file would block or never end."""
    for name in ("weights.safetensors", "deploy.json"):
        (copied / name).unlink()
        (copied / name).symlink_to("/dev/zero")
        with pytest.raises(DeployError, match="expected"):
            Runtime.load(copied)
        (copied / name).unlink()


def changed(deploy, path, value):
    *before, last = path
    place = deploy
    for one in before:
        place = place[one]
    if value is None:
        del place[last]
    else:
        place[last] = value


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (["schema"], "frasa.deploy/9", "schema"),
        (["compat"], "frasa2024", "Network"),
        (["weights_sha256"], "0" * 64, "export the policy again"),
        (["joints"], None, "joints"),
        (["joints"], 5, "wrong field"),
        (["joints"], [], "wrong field|do not go"),
        (["joints", 0], [1], "wrong field"),
        (["joints", 0, "mirror"], 1e9, "from -1 to 1"),
        (["joints", 0, "command_low_rad"], "-1", "expected a number"),
        (["joints", 0, "command_high_rad"], True, "expected a number"),
        (["control", "period_s"], 0, "expected a number"),
        (["control", "period_s"], float("nan"), "expected a number"),
        (["control"], [], "wrong field"),
        (["action", "rate_limit_rad_s"], 1e9, "expected a number"),
        (["held", "head_yaw"], float("inf"), "expected a number"),
        (["held"], [], "wrong field"),
        (["observation", 1, "name"], "torque", "do not go"),
        (["observation", 1, "size"], 6, "do not go"),
        (["observation", 1, "bound"], None, "wrong field|do not go"),
    ],
)
def test_a_description_that_cannot_be_is_refused(copied, path, value, message):
    """One clear line for every field that is missing, of another kind, or out of reason."""
    deploy = json.loads((copied / "deploy.json").read_text())
    changed(deploy, path, value)
    (copied / "deploy.json").write_text(json.dumps(deploy))
    with pytest.raises(DeployError, match=message):
        Runtime.load(copied)


def test_a_network_of_another_size_is_refused(exported, random_policy):
    """A description goes with the numbers its network sees and moves."""
    deploy = json.loads((exported / "deploy.json").read_text())
    with pytest.raises(DeployError, match="do not go"):
        Runtime(Network(random_policy(8, inputs=21).layers), deploy)


def test_a_policy_that_was_not_exported_can_act(policy, tmp_path):
    """Without a description there is no loop, but the network acts."""
    policy.save(tmp_path)
    layers, _ = frasa_rl.runtime.read_weights(tmp_path / "weights.safetensors")
    np.testing.assert_allclose(Network(layers).act(np.ones(22)), policy.act(np.ones(22)), atol=1e-6)
    with pytest.raises(DeployError, match=r"deploy\.json"):
        Runtime.load(tmp_path)
