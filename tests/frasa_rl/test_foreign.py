"""SB3's files come in only when trusted, nothing in them is executed even then, and they act as SB3 says."""

import base64
import io
import json
import pickle
import zipfile

import numpy as np
import pytest

from frasa_rl.cli import main
from frasa_rl.config import Task
from frasa_rl.foreign import foreign_policy, read_sb3
from frasa_rl.policy import Policy, PolicyError

pytest.importorskip("sb3_contrib")

import gymnasium
import torch
from sb3_contrib import CrossQ
from stable_baselines3 import SAC, TD3


class Nowhere(gymnasium.Env):
    """Spaces like the task's."""

    def __init__(self, inputs=22, reach=1.0):
        self.observation_space = gymnasium.spaces.Box(-30.0, 30.0, (inputs,), np.float32)
        self.action_space = gymnasium.spaces.Box(-reach, reach, (5,), np.float32)


def learner(kind, env=None, *, sde=False, **options):
    """An untrained one, with statistics and weights as after a training."""
    policy_kwargs = {"net_arch": [32, 24], **options}
    model = kind(
        "MlpPolicy", env or Nowhere(), buffer_size=10, policy_kwargs=policy_kwargs, device="cpu", seed=0,
        **({"use_sde": sde} if kind is not TD3 else {}),
    )  # fmt: skip
    with torch.no_grad():
        for name, tensor in model.policy.state_dict().items():
            if name.endswith("ra_mean"):
                tensor.copy_(torch.randn_like(tensor))
            elif name.endswith(("ra_var", "scale")):
                tensor.copy_(torch.exp(0.5 * torch.randn_like(tensor)))
            elif name.startswith("actor.mu"):
                tensor.copy_(torch.randn_like(tensor))  # reaches the clip of gSDE
    return model


def saved(model, path):
    model.save(path)
    return path


@pytest.mark.parametrize(
    ("kind", "sde", "options"),
    [
        (CrossQ, False, {}),
        (CrossQ, True, {}),
        (CrossQ, True, {"clip_mean": 0.0}),
        (CrossQ, True, {"clip_mean": 0.5, "batch_norm_eps": 0.1}),
        (SAC, False, {}),
        (SAC, True, {}),
        (SAC, False, {"net_arch": [16]}),
    ],
)
def test_a_converted_policy_acts_as_sb3_says(tmp_path, kind, sde, options):
    """Normalisation and gSDE's clip of the mean included, to 1e-5."""
    model = learner(kind, sde=sde, **options)
    seen = np.random.default_rng(0).uniform(-3.0, 3.0, (1000, 22)).astype(np.float32)
    expected, _ = model.predict(seen, deterministic=True)
    assert np.ptp(expected) > 0.5
    policy = Policy(read_sb3(saved(model, tmp_path / "model.zip"), trust=True))
    np.testing.assert_allclose(policy.act(seen), expected, atol=1e-5)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: learner(TD3), "no CrossQ or SAC actor"),
        (lambda: learner(SAC, activation_fn=torch.nn.Tanh), "expected ReLU"),
        (lambda: learner(SAC, Nowhere(reach=2.0)), "reach -2"),
    ],
)
def test_what_plain_layers_cannot_do_is_refused(tmp_path, make, message):
    """Another kind of actor, another activation, actions in another unit."""
    with pytest.raises(PolicyError, match=message):
        read_sb3(saved(make(), tmp_path / "model.zip"), trust=True)


class Bomb:
    """Leaves a file behind when it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return (open, (str(self.path), "w"))


def edited(path, packing=zipfile.ZIP_DEFLATED, **members):
    """A copy of a zip with other members."""
    with zipfile.ZipFile(path) as archive:
        kept = {name: archive.read(name) for name in archive.namelist()}
    out = path.with_name("edited.zip")
    with zipfile.ZipFile(out, "w", packing) as archive:
        for name, content in {**kept, **{name.replace("_pth", ".pth"): one for name, one in members.items()}}.items():
            if content is not None:
                archive.writestr(name, content)
    return out


@pytest.mark.filterwarnings("ignore:Detected pickle protocol")
def test_nothing_is_executed_even_when_trusted(tmp_path):
    """Pickles where SB3 would unpickle them stay shut: in `data` unread, in the tensors refused."""
    path, mark = saved(learner(SAC), tmp_path / "model.zip"), tmp_path / "executed"
    with zipfile.ZipFile(path) as archive:
        data = json.loads(archive.read("data"))
    bomb = base64.b64encode(pickle.dumps(Bomb(mark))).decode()
    data["policy_class"] = data["lr_schedule"] = {":type:": "x", ":serialized:": bomb}
    read_sb3(edited(path, data=json.dumps(data)), trust=True)
    assert not mark.exists()
    content = io.BytesIO()
    torch.save({"actor.mu.weight": Bomb(mark)}, content)
    for tensors in (content.getvalue(), pickle.dumps(Bomb(mark))):
        with pytest.raises(PolicyError, match="not an SB3 file"):
            read_sb3(edited(path, policy_pth=tensors), trust=True)
    assert not mark.exists()


@pytest.mark.parametrize(
    "members",
    [
        {"policy_pth": None},
        {"data": None},
        {"data": b"\xff"},
        {"data": b"[1]"},
        {"data": b"[" * 100_000},
        {"policy_pth": b""},
        {"policy_pth": b"no tensors"},
    ],
)
def test_broken_files_are_refused_in_one_line(tmp_path, members):
    """Members that are missing or nonsense."""
    with pytest.raises(PolicyError) as said:
        read_sb3(edited(saved(learner(SAC), tmp_path / "model.zip"), **members), trust=True)
    assert "\n" not in str(said.value)


def test_damage_in_packed_members_is_refused_in_one_line(tmp_path):
    """Wherever bytes of a deflated member are wrong: a checksum, or a stream that makes no sense."""
    path = edited(saved(learner(SAC), tmp_path / "model.zip"))
    whole = path.read_bytes()
    with zipfile.ZipFile(path) as archive:
        member = archive.getinfo("policy.pth")
    generator = np.random.default_rng(0)
    start = member.header_offset + 100
    for place in generator.integers(start, start + member.compress_size - 200, 30):
        path.write_bytes(whole[:place] + generator.bytes(60) + whole[place + 60 :])
        with pytest.raises(PolicyError, match="not an SB3 file") as said:
            read_sb3(path, trust=True)
        assert "\n" not in str(said.value)


@pytest.mark.parametrize("packing", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_what_sb3_does_not_pack_with_is_refused(tmp_path, packing):
    """Other ways to pack raise errors of their own for damage."""
    with pytest.raises(PolicyError, match="packed in another way than deflate"):
        read_sb3(edited(saved(learner(SAC), tmp_path / "model.zip"), packing), trust=True)


def test_what_is_no_zip_is_refused(tmp_path):
    """Another file under that name, and none."""
    path = tmp_path / "model.zip"
    with pytest.raises(PolicyError, match="no policy at"):
        read_sb3(path, trust=True)
    path.write_bytes(b"PK\x03\x04 nothing")
    with pytest.raises(PolicyError, match="not an SB3 file"):
        read_sb3(path, trust=True)


def test_a_bomb_of_zeros_is_not_unpacked(tmp_path, monkeypatch):
    """A member that says it is larger than any policy is left alone."""
    monkeypatch.setattr("frasa_rl.foreign._LARGEST", 10_000)
    path = edited(saved(learner(SAC), tmp_path / "model.zip"), data=b" " * 20_000)
    with pytest.raises(PolicyError, match="larger than"):
        read_sb3(path, trust=True)


@pytest.mark.parametrize("command", ["export", "evaluate", "play", "rank"])
def test_without_trust_a_stranger_stays_out(tmp_path, nominal, command, capsys):
    """One line that says why and what to do, exit 3, before anything in the file is read."""
    path = tmp_path / "model.zip"
    path.write_bytes(b"")
    more = ["--video", str(tmp_path / "f.png")] if command == "play" else []
    assert main([command, str(path), "--model", str(nominal), *more]) == 3
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    assert "pickled Python" in lines[0]
    assert "--trust" in lines[0]


def test_with_trust_it_is_exported_and_evaluated(tmp_path, nominal, calibrated, capsys):
    """What the file does not say, its user did: model, calibration and task, and the folder says who said it."""
    pytest.importorskip("onnx")
    path, out = saved(learner(CrossQ), tmp_path / "model.zip"), tmp_path / "out"
    assert main(["export", str(path), "--trust", "--model", str(calibrated), "--out", str(out)]) == 0
    run = Policy.load(out).run
    assert (run["calibration_id"], run["origin"]) == ("c0ffee", "SB3 file model.zip")
    assert "as said by who converted it" in run["stated"]
    deploy = json.loads((out / "deploy.json").read_text())
    assert (deploy["calibration_id"], deploy["trained"]["origin"]) == ("c0ffee", "SB3 file model.zip")
    capsys.readouterr()
    words = ["--protocol", "standup", "--trials", "1", "--model", str(calibrated), "--json"]
    tables = []
    for word in ([str(path), "--trust"], [str(out)]):
        assert main(["evaluate", *word, *words, "--no-report"]) == 0
        tables.append(json.loads(capsys.readouterr().out)["standup"])
    assert tables[0] == tables[1]
    small = saved(learner(CrossQ, Nowhere(inputs=4)), tmp_path / "small.zip")
    assert main(["evaluate", str(small), "--trust", "--model", str(nominal)]) == 3
    assert "sees 4 numbers" in capsys.readouterr().err


def test_the_model_it_is_said_to_be_trained_on_counts(tmp_path, nominal):
    """A nominal model leaves no calibration id."""
    policy = foreign_policy(saved(learner(SAC), tmp_path / "model.zip"), Task(), nominal, trust=True)
    assert policy.run["calibration_id"] is None
    assert policy.run["model"] == str(nominal)
