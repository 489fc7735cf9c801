"""Our CrossQ against sb3-contrib's: the same batches and noise, then the same weights, statistics and moments."""

from typing import ClassVar

import numpy as np
import pytest

pytest.importorskip("sb3_contrib")
import torch
from sb3_contrib import CrossQ

from frasa_rl.crossq import FastCrossQ
from frasa_rl.crossq_gpu import Device

SMALL = {"seen": 37, "acted": 3, "pi": (40, 33), "qf": (48, 33, 24), "batch": 21}


def numbers_of(model):
    """All that an update changes."""
    found = {name: value.detach().double().clone() for name, value in model.policy.state_dict().items()}
    optimizers = {"actor": model.actor.optimizer, "critic": model.critic.optimizer, "alpha": model.ent_coef_optimizer}
    for name, optimizer in optimizers.items():
        for i, owner in enumerate(optimizer.param_groups[0]["params"] if optimizer else []):
            for key, value in optimizer.state.get(owner, {}).items():
                found[f"{name} {i} {key}"] = value.double().clone()
    if model.log_ent_coef is not None:
        found["log_ent_coef"] = model.log_ent_coef.detach().double().clone()
    return found


def trained(model, updates, batch, calls=1):
    torch.manual_seed(5)
    np.random.seed(5)  # noqa: NPY002 - SB3 draws from it
    for _ in range(calls):
        model.train(updates // calls, batch)
    return numbers_of(model)


def apart(one, other, only=""):
    assert one.keys() == other.keys()
    return max(float((one[name] - other[name]).abs().max()) for name in one if only in name)


class OnTorch(FastCrossQ):
    """What runs on a GPU, on a processor."""

    _engines: ClassVar = {"cpu": Device}


@pytest.mark.parametrize("kind", [FastCrossQ, OnTorch])
@pytest.mark.parametrize(
    "settings",
    [
        {"pi": (128, 128), "qf": (128, 128), "batch": 128, "updates": 200, "calls": 8},
        {**SMALL, "updates": 60, "warmup": 20, "policy_delay": 1},
        {**SMALL, "updates": 60, "warmup": 0, "n_steps": 3},
        {**SMALL, "updates": 30, "ent_coef": 0.05},
        {**SMALL, "updates": 30, "ent_coef": "auto_0.01", "target_entropy": -1.5, "policy": {"n_critics": 3}},
        {**SMALL, "updates": 30, "policy": {"batch_norm_momentum": 0.1, "batch_norm_eps": 1e-5}},
        {**SMALL, "updates": 30, "policy": {"n_critics": 1, "optimizer_kwargs": {"betas": (0.9, 0.99), "eps": 1e-5}}},
    ],
    ids=["as published", "delay 1", "warm, n-step", "fixed entropy", "three critics", "other norm", "other Adam"],
)
def test_the_same_in_double_precision(crossq_model, settings, kind):
    """In double precision nothing differs by more than rounding does: before, at and after the renorm's warm-up."""
    settings = dict(settings)
    updates, batch, calls = settings.pop("updates"), settings.pop("batch"), settings.pop("calls", 1)
    theirs = trained(crossq_model(CrossQ, double=True, **settings), updates, batch, calls)
    model = crossq_model(kind, double=True, **settings)
    assert model.fast
    assert apart(trained(model, updates, batch, calls), theirs) < 1e-9


def test_single_precision_differs_as_sb3_contrib_does_from_itself(crossq_model):
    """Rounding grows: 200 updates in single precision end as near as sb3-contrib with torch's other Adam ends."""
    betas = {"betas": (0.5, 0.999)}
    theirs = trained(crossq_model(CrossQ, policy={"optimizer_kwargs": betas}), 200, 128)
    fused = trained(crossq_model(CrossQ, policy={"optimizer_kwargs": {**betas, "fused": True}}), 200, 128)
    ours = trained(crossq_model(FastCrossQ, policy={"optimizer_kwargs": betas}), 200, 128)
    for part in ("weight", "ra_mean", "exp_avg_sq"):
        assert apart(ours, theirs, part) < 10.0 * apart(fused, theirs, part) + 1e-4


def test_single_precision_of_a_first_update(crossq_model):
    """One update, too short for rounding to grow: weights and statistics agree to 1e-5, the policy's included."""
    settings = {"policy_delay": 1, "pi": (128, 128), "qf": (128, 128)}
    theirs = trained(crossq_model(CrossQ, **settings), 1, 128)
    ours = trained(crossq_model(FastCrossQ, **settings), 1, 128)
    for part in ("latent_pi", "critic.qf", "mu", "log_std", "log_ent_coef"):
        assert apart(ours, theirs, part) < 1e-5


def test_logged_alike(crossq_model):
    """The logger is told the same values under the same names."""
    told = []
    for kind in (CrossQ, FastCrossQ):
        model = crossq_model(kind, double=True, **{k: v for k, v in SMALL.items() if k != "batch"})
        trained(model, 9, 21)
        told.append(model.logger.name_to_value)
    assert told[0].keys() == told[1].keys()
    for name, value in told[0].items():
        assert told[1][name] == pytest.approx(value, rel=1e-6, abs=1e-9), name


def test_weight_norm_is_one_thing_on_both(crossq_model):
    """With weights kept at their lengths both ways of ours agree, and differ from learning without."""
    settings = {name: value for name, value in SMALL.items() if name != "batch"}
    kept = [
        trained(crossq_model(kind, double=True, weight_norm=True, **settings), 30, 21) for kind in (FastCrossQ, OnTorch)
    ]
    assert apart(*kept) < 1e-9
    assert apart(kept[0], trained(crossq_model(FastCrossQ, double=True, **settings), 30, 21)) > 1e-4
