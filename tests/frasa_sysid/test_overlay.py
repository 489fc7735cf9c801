"""Measured and simulated traces of a robot in one file, and the layout that plots them."""

import json
from collections import defaultdict
from dataclasses import replace
from operator import attrgetter

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from frasa_sysid.calibration import run_command
from frasa_sysid.cli import build_parser
from frasa_sysid.excitation_standing import design as standing
from frasa_sysid.overlay import LAYOUT, prefixes
from frasa_sysid.readers import read_log
from frasa_sysid.robot_body import joints_of
from frasa_sysid.robot_truth import draw
from frasa_sysid.simulate_robot import IDEAL, simulate_robot
from frasa_sysid.writer import write_mcap


@pytest.fixture(scope="module")
def log(robot_model_dir, tmp_path_factory):
    """Two seconds of a robot on its feet."""
    path = robot_model_dir / "nominal.xml"
    joints = joints_of(path)
    truth = replace(draw("floating", 5, joints.classes, joints.names), zeros=None)
    recording = simulate_robot(path, joints, truth, standing(joints, 10.0), 2.4, "ground.mcap", IDEAL, timestep=0.0005)
    out = tmp_path_factory.mktemp("overlay") / "ground.mcap"
    write_mcap(out, [recording])
    return out


def test_the_layout_plots_what_is_written(robot_model_dir, log, capsys, tmp_path, made_of):
    """Every path of the layout for Foxglove leads to numbers in the MCAP of `compare --mcap`, of the same joint."""
    out = tmp_path / "both.mcap"
    words = ["compare", log, "--model", robot_model_dir / "nominal.xml", "--json", "--mcap", out]
    words += ["--with-model", robot_model_dir / "calibrated.xml"]
    assert run_command(build_parser(), [str(word) for word in words]) == 0
    printed, said = capsys.readouterr()
    found = json.loads(printed)
    assert found["outputs"]["mcap"] == str(out)
    assert str(LAYOUT) in said
    assert made_of(out)["inputs"] == found["inputs"]
    layout = json.loads(LAYOUT.read_text())
    paths = [one["value"] for panel in layout["configById"].values() for one in panel.get("paths", ())]
    messages = defaultdict(list)
    with out.open("rb") as file:
        for _, channel, _, message in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages():
            messages[channel.topic].append(message)
    joint = layout["globalVariables"]["joint"]
    assert len(paths) == 8
    names = set()
    for path in paths:
        topic, _, field = path.partition(".")
        array, _, index = field.partition("[")
        values = [attrgetter(array)(one) for one in messages[topic]]
        if index:
            assert index == "$joint]"
            filled = [(one.name, value[joint]) for one, value in zip(messages[topic], values, strict=True) if value]
            names |= {tuple(one) for one, _ in filled}
            values = [value for _, value in filled]
        assert len(values) > 20
        assert np.isfinite(values).all()
    assert len(names) == 1
    recording = read_log(out)[0]
    simulated, measured = recording.signal("position@/sim/joint_states"), recording.signal("position")
    same = np.isin(np.round(measured.t, 6), np.round(simulated.t, 6))
    error = np.abs(measured.y[same] - simulated.y).mean()
    assert error == pytest.approx(found["candidates"]["calibrated.xml"]["mae_rad"], rel=1e-6)


def test_topics_of_many():
    """The last one has the plain topics; names that would become one topic are told apart."""
    assert prefixes(["nominal"]) == {"nominal": "/sim/"}
    found = prefixes(["nominal", "a b.xml", "a-b.json", "last.json"])
    assert list(found.values()) == ["/sim/nominal/", "/sim/a_b/", "/sim/a_b_2/", "/sim/"]
