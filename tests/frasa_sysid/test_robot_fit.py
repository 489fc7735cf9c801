"""The whole-robot fit against the virtual robot, MuJoCo's own delays, and bad logs."""

import json
import shutil
from contextlib import suppress
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from frasa_sysid import stored_fit, stored_robot_fit
from frasa_sysid.calibration import load_model, read, run_command
from frasa_sysid.cli import build_parser
from frasa_sysid.errors import LogError, UsageError
from frasa_sysid.readers import read_log
from frasa_sysid.recording import Signal
from frasa_sysid.robot_body import bare
from frasa_sysid.robot_candidate import Candidate, Writer
from frasa_sysid.robot_fit import fit_robot, frozen_model, model_delays
from frasa_sysid.robot_problem import state_robot_problem
from frasa_sysid.robot_residuals import Comparison, tilt, whitened
from frasa_sysid.robot_rig import robot_run
from frasa_sysid.robot_simulator import RobotSimulator, bare_model, delayed, pieces_of
from frasa_sysid.robot_stance import level_zeros
from frasa_sysid.robot_trail import Trail, place_from
from frasa_sysid.writer import write_mcap

GROUPS = ("delays", "gain", "damping", "friction")


@pytest.fixture(scope="module")
def fits(robot_model_dir):
    return [stored_fit.load(robot_model_dir / "fits" / f"{servo}.json") for servo in ("mx106", "mx64")]


@pytest.fixture(scope="module")
def frozen(robot_model_dir, fits, tmp_path_factory):
    return frozen_model(robot_model_dir / "nominal.xml", fits, tmp_path_factory.mktemp("frozen"))


@pytest.fixture(scope="module")
def recording(held_robot):
    """Eight seconds of a held robot with random truth but no zeros, as its computer records them."""
    return held_robot(8.0, "robot.mcap")


@pytest.fixture(scope="module")
def found(robot_model_dir, fits, recording):
    return fit_robot(robot_model_dir / "nominal.xml", fits, [recording], groups=GROUPS)


def test_finds_what_the_virtual_robot_is(found, recording):
    """Delays within a millisecond and scales within 5 %, inside their intervals, from eight seconds."""
    truth = dict(recording.truth)
    age = truth["sensor.position_delay"]
    truth["command.delay"] = truth["mx64.delay"] + age
    truth["sensor.velocity_delay"] -= age
    for free, value, half in zip(found.problem.free, found.settled.x, found.half, strict=True):
        allowed = 0.001 if free.kind.unit == "s" else 0.05
        assert value == pytest.approx(truth[free.name], abs=allowed), free.name
        assert half < 0.1
    inside = [
        abs(value - truth[free.name]) <= half
        for free, value, half in zip(found.problem.free, found.settled.x, found.half, strict=True)
    ]
    assert np.mean(inside) >= 0.75
    assert found.errors["fitted"]["position"][0] < 0.3 * found.errors["nominal"]["position"][0]


def test_the_models_delays_differ_by_half_a_step(found):
    """Estimates are what a MuJoCo model takes: commands half a step later, speeds half a step earlier."""
    by_name = {one.name: one for one in found.estimates()}
    physical = dict(zip((one.name for one in found.problem.free), found.settled.x, strict=True))
    assert by_name["command.delay"].value == pytest.approx(physical["command.delay"] + 0.001)
    assert by_name["sensor.velocity_delay"].value == pytest.approx(physical["sensor.velocity_delay"] - 0.001)
    assert all(one.low <= one.value <= one.high for one in by_name.values())


def test_commands_are_late_as_in_mujoco(robot_model_dir, frozen, recording):
    """A command delay of the simulator is that of the actuators of a published model, step by step."""
    late = 0.0137  # [s] in the model; physically half a step less
    with RobotSimulator(frozen, "fixed", 1) as simulator:
        run = robot_run(recording, simulator.model)
        piece = pieces_of(run, simulator.timestep, 2.0, 0.3)[1]
        one = Candidate(command_delay=late - simulator.timestep / 2)
        _, _, states = next(simulator.simulate([piece], [one], Candidate()))
        model = simulator.model
        supply = float(run.supply[piece.first : piece.end + 1].mean())
        spec_model = _with_history(frozen)
        Writer(model).write(spec_model, one, supply, run.firmware_gain)
        spec_model.opt.gravity[:] = simulator._pool[0].opt.gravity
    spec_model.actuator_delay[:] = late
    data = mujoco.MjData(spec_model)
    data.qpos[:], data.qvel[:] = states[0][: model.nq], states[0][model.nq :]
    size = int(spec_model.actuator_history[0, 0])
    times = (np.arange(size) - size) * spec_model.opt.timestep
    for i in range(spec_model.nu):
        mujoco.mj_initCtrlHistory(spec_model, data, i, times, run.goal[piece.first - size : piece.first, i])
    for k in range(300):
        data.ctrl[:] = run.goal[piece.first + k]
        mujoco.mj_step(spec_model, data)
        assert np.abs(data.qpos - states[k + 1][: model.nq]).max() < 1e-6, k


def _with_history(frozen):
    """The held robot as `bare_model` makes it, but with MuJoCo's own command history."""
    return bare(frozen, held=True, plain=False)


def test_delayed_commands():
    """Whole and broken delays, and what lies before the first command."""
    goal = np.arange(10.0)[:, None]
    assert delayed(goal, 3, 4, 2.0)[:, 0].tolist() == [1.0, 2.0, 3.0, 4.0]
    assert delayed(goal, 3, 4, 0.25)[:, 0] == pytest.approx([2.75, 3.75, 4.75, 5.75])
    assert delayed(goal, 0, 3, 2.5)[:, 0] == pytest.approx([0.0, 0.0, 0.0])


def test_a_zero_turns_geometry_only(robot_model_dir, frozen):
    """At a measured angle the feet are where those of a robot without zeros are at the true angle; nothing adds up."""
    model = bare_model(frozen, "fixed")
    writer, copy = Writer(model), bare_model(frozen, "fixed")
    zeros = {"left_knee": 0.03, "left_hip_roll": -0.02, "right_elbow": 0.05}
    for _ in range(3):
        writer.write(copy, Candidate(zeros=zeros), 15.0, None)
    plain, turned = mujoco.MjData(model), mujoco.MjData(copy)
    measured = np.random.default_rng(0).uniform(-0.5, 0.5, model.nq)
    turned.qpos[:] = measured
    true = measured.copy()
    for name, zero in zeros.items():
        true[model.joint(name).qposadr[0]] -= zero
    plain.qpos[:] = true
    mujoco.mj_kinematics(model, plain)
    mujoco.mj_kinematics(copy, turned)
    assert turned.geom_xpos == pytest.approx(plain.geom_xpos, abs=1e-12)
    writer.write(copy, Candidate(), 15.0, None)
    assert (copy.qpos0 == model.qpos0).all()
    assert (copy.actuator_gainprm == model.actuator_gainprm).all()


def test_scales_and_supply(frozen):
    """Gain and torque limit go with the supply and their scale, friction with its own, the trunk with its mass."""
    model = bare_model(frozen, "fixed")
    copy, writer = bare_model(frozen, "fixed"), Writer(model)
    one = Candidate(gain={"mx64": 1.1}, damping={"mx106": 0.9}, friction={"mx64": 2.0}, trunk_mass=4.0)
    writer.write(copy, one, 0.9 * writer.stated_supply, None)
    assert read(copy, "mx64.kp") == pytest.approx(1.1 * 0.9 * read(model, "mx64.kp"))
    assert read(copy, "mx106.forcerange") == pytest.approx(0.9 * read(model, "mx106.forcerange"))
    assert read(copy, "mx106.damping") == pytest.approx(0.9 * read(model, "mx106.damping"))
    assert read(copy, "mx64.load_motor_stribeck") == pytest.approx(2.0 * read(model, "mx64.load_motor_stribeck"))
    assert read(copy, "mx106.stribeck") == pytest.approx(read(model, "mx106.stribeck"))
    ratio = 4.0 / model.body_mass[1]
    assert copy.body_inertia[1] == pytest.approx(model.body_inertia[1] * ratio)


def test_a_channel_of_age_d_is_read_d_earlier(frozen, recording):
    """Readings move by the age of their channel, to a fraction of a step, and no other channel's do."""
    with RobotSimulator(frozen, "fixed", 1) as simulator:
        run = robot_run(recording, simulator.model)
        compared = Comparison(simulator, pieces_of(run, simulator.timestep, 1.0, 0.3)[2:3])
        names = np.array([name.split()[0] for name in compared.layout.names])[compared.layout.column]
        young, old = (Candidate(ages={"velocity": age}) for age in (0.010, 0.0104))
        first, second = compared.residuals([young, old], Candidate())
    moved = second - first
    assert np.abs(moved[names == "position"]).max() == 0.0
    assert 1e-4 < np.abs(moved[names == "velocity"]).max() < 0.1


def test_tilt_knows_no_heading():
    """Roll and pitch are those of gravity, whatever the yaw."""
    for yaw in (0.0, 1.0, -2.0):
        whole = np.array([1.0, 0.0, 0.0, 0.0])
        for axis, angle in (((0, 0, 1), yaw), ((0, 1, 0), -0.3), ((1, 0, 0), 0.1)):
            turn, product = np.zeros(4), np.zeros(4)
            mujoco.mju_axisAngle2Quat(turn, np.array(axis, dtype=np.float64), angle)
            mujoco.mju_mulQuat(product, whole, turn)
            whole = product
        assert tilt(whole[None])[0] == pytest.approx([0.1, -0.3], abs=1e-12)


def test_what_a_held_robot_cannot_show_is_not_free(robot_model_dir, recording):
    """Ages of gyro and orientation need the robot on the ground; an unknown group is refused."""
    model = load_model(robot_model_dir / "nominal.xml")
    run = robot_run(recording, model)
    problem = state_robot_problem([run], ("mx64",), model_delays(model, 0.0), 3.0)
    names = {one.name for one in problem.free}
    assert "sensor.velocity_delay" in names
    assert not {"sensor.gyro_delay", "sensor.orientation_delay"} & names
    with pytest.raises(UsageError, match="expected delays, zeros"):
        state_robot_problem([run], ("mx64",), model_delays(model, 0.0), 3.0, ("delay",))


def test_bad_logs_say_what_to_do(robot_model_dir, recording):
    """A missing goal, joint or base, a slow log and one with a hole: one sentence each."""
    model = load_model(robot_model_dir / "nominal.xml")
    signals = dict(recording.signals)
    position = signals["position"]

    def with_position(t, y):
        return replace(recording, signals=signals | {"position": Signal("position", "rad", t, y, position.columns)})

    without = replace(recording, signals={name: one for name, one in signals.items() if name != "goal"})
    with pytest.raises(LogError, match=r"no 'goal' signal.*joint_command"):
        robot_run(without, model)
    lame = Signal("position", "rad", position.t, position.y[:, :3], position.columns[:3])
    with pytest.raises(LogError, match=r"'position' lacks .*left_knee"):
        robot_run(replace(recording, signals=signals | {"position": lame}), model)
    with pytest.raises(UsageError, match="--base fixed or floating"):
        robot_run(replace(recording, rig=replace(recording.rig, base=None)), model)
    with pytest.raises(LogError, match="record at 50 Hz"):
        robot_run(with_position(position.t[::20], position.y[::20]), model)
    keep = (position.t < 3.0) | (position.t > 4.0)
    holed = with_position(position.t[keep], position.y[keep])
    with pytest.raises(LogError, match="no position for 1"):
        robot_run(holed, model)


def test_from_the_command_line_into_the_model(robot_model_dir, recording, tmp_path):
    """fit LOG --publish beside the bench fits: the model takes the delays, the file says what is known as a sum."""
    folder = tmp_path / "robot_model"
    shutil.copytree(robot_model_dir, folder)
    log = tmp_path / "robot.mcap"
    write_mcap(log, [recording])
    command = ["fit", str(log), "--model", str(folder / "nominal.xml"), "--free", "delays", "--publish", "--no-report"]
    assert run_command(build_parser(), [*command, "--hold-out-share", "0.3"]) == 0
    data = json.loads((folder / "fits" / "robot.json").read_text())
    assert data["kind"] == "robot"
    assert data["misfit"]["held_out_fitted"]["mae_rad"] < data["misfit"]["held_out_nominal"]["mae_rad"]
    assert "sum only" in " ".join(data["not_in_model"])
    stored = stored_robot_fit.load(folder / "fits" / "robot.json")
    model = load_model(folder / "calibrated.xml")
    for name in ("mx64.delay", "mx106.delay", "sensor.velocity_delay"):
        assert read(model, name) == pytest.approx(stored.parameters[name]["value"], abs=1e-12)
    assert not list((folder / "fits").glob("*.partial.json"))
    assert read_log(log)[0].rig.base == "fixed"


def test_a_joint_mounted_the_other_way_round_is_refused(robot_model_dir, recording, tmp_path, capsys):
    """A measured position with the wrong sign ends the command before a fit is misled by it, with status 3."""
    position = recording.signals["position"]
    y = position.y.copy()
    y[:, position.columns.index("head_pitch")] *= -1.0
    turned = Signal("position", "rad", position.t, y, position.columns)
    log = tmp_path / "robot.mcap"
    write_mcap(log, [replace(recording, signals={**recording.signals, "position": turned})])
    out = tmp_path / "robot.json"
    command = ["fit", str(log), "--model", str(robot_model_dir / "nominal.xml"), "--out", str(out), "--free", "delays"]
    assert run_command(build_parser(), command) == 3
    assert "head_pitch" in capsys.readouterr().err
    assert not out.exists()


class KilledError(Exception):
    """In place of kill -9."""


class Keeper:
    """Keeps places as a file does; dies once, as one is written."""

    def __init__(self, dies_at=None):
        self.places, self.dies_at = [], dies_at

    def __call__(self, place):
        if len(self.places) + 1 == self.dies_at:
            raise KilledError
        self.places.append(json.dumps(place, allow_nan=False))

    @property
    def last(self):
        return place_from(json.loads(self.places[-1])) if self.places else None


def assert_same_fit(one, other):
    np.testing.assert_array_equal(one.settled.x, other.settled.x)
    np.testing.assert_array_equal(one.covariance, other.covariance)
    np.testing.assert_array_equal(one.half, other.half)
    assert one.errors == other.errors
    for name in ("cost", "iterations", "evaluations", "converged"):
        assert getattr(one.settled, name) == getattr(other.settled, name)


@pytest.mark.parametrize("base", ["fixed", "floating"])
def test_a_fit_killed_anywhere_comes_to_the_same(robot_model_dir, fits, held_robot, standing_robot, base):
    """Killed early and late, and soon after again: the same to the last bit and count."""
    one = held_robot(2.0, "held.mcap") if base == "fixed" else standing_robot(1.0, "standing.mcap")

    def fitted(trail):
        return fit_robot(robot_model_dir / "nominal.xml", fits, [one], groups=("delays",), trail=trail)

    whole = Keeper()
    unbroken = fitted(Trail(None, whole))
    assert len(whole.places) > 4
    for dies_at in (3, len(whole.places)) if base == "fixed" else (len(whole.places) // 2 + 1,):
        first, second = Keeper(dies_at), Keeper(2)
        with pytest.raises(KilledError):
            fitted(Trail(None, first))
        with suppress(KilledError):
            fitted(Trail(first.last, second))
        assert_same_fit(fitted(Trail(second.last or first.last)), unbroken)


def test_an_interrupted_fit_goes_on(robot_model_dir, held_robot, tmp_path, monkeypatch, capsys):
    """Ctrl-C keeps the last step, and the same command comes to what an unbroken one does; another one begins anew."""
    folder = tmp_path / "robot_model"
    shutil.copytree(robot_model_dir, folder)
    log = tmp_path / "robot.mcap"
    write_mcap(log, [held_robot(2.0, "held.mcap")])
    from frasa_sysid.commands import fit_robot as command

    real, partial = command.write_atomic, folder / "fits" / "robot.partial.json"

    def stopping(path, text):
        real(path, text)
        raise KeyboardInterrupt

    arguments = ["fit", str(log), "--model", str(folder / "nominal.xml"), "--free", "delays", "--no-report"]
    monkeypatch.setattr(command, "write_atomic", stopping)
    for _ in range(2):
        assert run_command(build_parser(), arguments) == 130
        assert f"its last step is in {partial}, the same command goes on" in capsys.readouterr().err
    reached = json.loads(partial.read_text())["place"]
    assert reached["moves"]
    assert not (folder / "fits" / "robot.json").exists()
    monkeypatch.setattr(command, "write_atomic", real)
    assert run_command(build_parser(), arguments) == 0
    kept = (folder / "fits" / "robot.json").read_bytes()
    assert not partial.exists()
    for content in ("{", json.dumps({"identity": "another", "place": reached})):
        partial.write_text(content)
        assert run_command(build_parser(), arguments) == 0
        assert (folder / "fits" / "robot.json").read_bytes() == kept


def test_a_quaternion_and_its_negative_are_one_orientation(robot_model_dir, recording):
    """An IMU that jumps to the other quaternion of the same orientation gives the same channel."""
    model = load_model(robot_model_dir / "nominal.xml")
    signal = recording.signals["orientation"]
    signs = np.where(np.arange(signal.t.size) % 7 < 3, 1.0, -1.0)[:, None]
    jumping = Signal(signal.name, signal.unit, signal.t, signal.y * signs, signal.columns)
    plain = robot_run(recording, model).channels["orientation"].y
    found = robot_run(replace(recording, signals={**recording.signals, "orientation": jumping}), model)
    assert found.channels["orientation"].y == pytest.approx(plain, abs=1e-15)


def test_a_robot_put_down_stands_on_both_feet(standing_robot, frozen):
    """Each candidate starts on its own feet, whatever its zeros are: both touch, neither is pushed in."""
    recording = standing_robot(1.5, "standing.mcap")
    with RobotSimulator(frozen, "floating", 1) as simulator:
        run, model = robot_run(recording, simulator.model), simulator.model
        piece = pieces_of(run, simulator.timestep, 0.4, 0.1)[0]
        several = [Candidate(), Candidate(zeros={"left_ankle_pitch": 0.02, "right_hip_roll": -0.02})]
        found = {c: states[0] for c, _, states in simulator.simulate([piece], several, Candidate())}
        for c, one in enumerate(several):
            simulator.writer.write(model, one, 15.0, None)
            data = mujoco.MjData(model)
            data.qpos[:] = found[c][: model.nq]
            mujoco.mj_forward(model, data)
            depths: dict[str, float] = {}
            for contact in data.contact:
                name = model.geom(max(contact.geom)).name.partition("_")[0]
                depths[name] = max(depths.get(name, 0.0), -contact.dist)
            assert set(depths) == {"left", "right"}
            assert 1e-5 < min(depths.values()) < max(depths.values()) < 2e-3
    assert found[0][2] != pytest.approx(found[1][2], abs=1e-5)


def test_candidates_that_are_read_differently_are_one_robot(frozen, recording):
    """Other ages of channels, the same states; another zero, other states."""
    with RobotSimulator(frozen, "fixed", 1) as simulator:
        run = robot_run(recording, simulator.model)
        pieces = pieces_of(run, simulator.timestep, 1.0, 0.3)[:2]
        several = [Candidate(), Candidate(ages={"velocity": 0.02}), Candidate(zeros={"left_knee": 0.01})]
        found = {(c, p): states for c, p, states in simulator.simulate(pieces, several, Candidate())}
    assert len(found) == 6
    assert found[0, 0] is found[1, 0]
    assert not np.array_equal(found[0, 1], found[2, 1])


def test_on_the_ground_the_trunk_is_free_unless_told(robot_model_dir, recording, standing_robot):
    """Its weight would be taken for zeros; a user who fixes it gets wider intervals of the zeros."""
    model = load_model(robot_model_dir / "nominal.xml")
    held, standing = (robot_run(one, model) for one in (recording, standing_robot(1.5, "standing.mcap")))
    delays = model_delays(model, 0.0)
    by_default = {one.name for one in state_robot_problem([held], ("mx64",), delays, 3.0).free}
    assert "trunk.mass_scale" not in by_default
    both = {one.name: one for one in state_robot_problem([held, standing], ("mx64",), delays, 3.0).free}
    assert {"trunk.mass_scale", "sensor.gyro_delay"} <= set(both)
    told = {one.name: one for one in state_robot_problem([standing], ("mx64",), delays, 3.0, ("zeros",)).free}
    assert told["left_knee.zero"].kind.trust > 3.0 * both["left_knee.zero"].kind.trust


def test_a_slow_error_of_an_orientation_is_whitened(standing_robot, frozen):
    """What a filter's error carries over is taken off, sample by sample and piece by piece; joints have no memory."""
    with RobotSimulator(frozen, "floating", 1) as simulator:
        run = robot_run(standing_robot(1.5, "standing.mcap"), simulator.model)
        layout = Comparison(simulator, pieces_of(run, simulator.timestep, 0.4, 0.1)).layout
    tilts = np.char.startswith(np.array(layout.names)[layout.column], "orientation")
    assert (layout.before[~tilts] == -1).all()
    firsts = tilts & (layout.before == -1)
    pieces = 3
    assert firsts.sum() == 2 * pieces
    assert (layout.column[layout.before[tilts & ~firsts]] == layout.column[tilts & ~firsts]).all()
    constant = whitened(np.ones(tilts.size), layout)
    assert (constant[firsts] == 1.0).all()
    assert np.abs(constant[tilts & ~firsts]).max() < 0.2
    assert (constant[~tilts] == 1.0).all()


def test_flat_feet_tell_zeros(standing_robot, frozen):
    """An ankle whose encoder is turned shows in a standing robot's feet, before anything is simulated."""
    recording = standing_robot(1.5, "standing.mcap")
    position = recording.signals["position"]
    y = position.y + 0.03 * (np.array(position.columns) == "left_ankle_pitch")
    turned = Signal("position", "rad", position.t, y, position.columns)
    pitch = []
    with RobotSimulator(frozen, "floating", 1) as simulator:
        for one in (recording, replace(recording, signals={**recording.signals, "position": turned})):
            run = robot_run(one, simulator.model)
            zeros = level_zeros(bare_model(frozen, "floating"), simulator.writer, simulator.trunk, run, {})
            pitch.append(sum(zeros[f"left_{name}"] for name in ("hip_pitch", "knee", "ankle_pitch")))
    assert pitch[1] - pitch[0] == pytest.approx(0.03, abs=0.005)
