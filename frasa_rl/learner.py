"""CrossQ of sb3-contrib as it stands: built from our settings, saved and restored, turned into a plain policy."""

import random
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from sb3_contrib import CrossQ
from sb3_contrib.common.torch_layers import BatchRenorm1d
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.vec_env import VecEnv

from frasa_rl.policy import Array, Policy
from frasa_rl.settings import Settings
from frasa_sysid.calibration import UsageError

_BUFFER_FIELDS = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


def build(settings: Settings, envs: VecEnv, device: str) -> CrossQ:
    """A new learner; the seed is the settings'.

    Raises:
        UsageError: `cuda` without a CUDA device.
    """
    if device == "cuda" and not torch.cuda.is_available():
        raise UsageError("no CUDA device that torch can use: give --device cpu")
    torch.set_num_threads(settings.threads)
    steps, updates = settings.rounds
    exploration: dict[str, float] = {"log_std_init": settings.smooth_log_std} if settings.smooth else {}
    return CrossQ(
        "MlpPolicy",
        envs,
        learning_rate=settings.learning_rate,
        buffer_size=settings.buffer,
        learning_starts=settings.learning_starts,
        batch_size=settings.batch,
        gamma=settings.discount,
        train_freq=steps,
        gradient_steps=updates,
        n_steps=settings.n_step,
        policy_delay=settings.policy_delay,
        ent_coef=f"auto_{settings.entropy}",
        use_sde=settings.smooth,
        use_sde_at_warmup=settings.smooth,
        sde_sample_freq=settings.smooth_steps if settings.smooth else -1,
        policy_kwargs={
            **exploration,
            "clip_mean": 0.0,  # the plain policy has no limit before its hyperbolic tangent
            "net_arch": {"pi": list(settings.actor), "qf": list(settings.critic)},
            "renorm_warmup_steps": settings.renorm_warmup,
            # CrossQ's own first moment, and the optimizer's steps in one call: a fifth more updates a second.
            "optimizer_kwargs": {"betas": (0.5, 0.999), "fused": True},
        },
        seed=settings.seed,
        device=device,
    )


def plain_policy(model: CrossQ, run: dict[str, Any]) -> Policy:
    """The actor's mean action as linear layers, each with the normalisation before it folded in.

    Batch renormalisation at inference is a x + c with a = scale / sqrt(var + eps) and
    c = bias - a mean, so W (a x + c) + b = (W a) x + (W c + b).
    """
    layers: list[tuple[Array, Array]] = []
    gain, offset = np.ones(1), np.zeros(1)
    for module in [*model.actor.latent_pi, model.actor.mu]:
        if isinstance(module, BatchRenorm1d):
            gain = _array(module.scale) / np.sqrt(_array(module.ra_var) + module.eps)
            offset = _array(module.bias) - gain * _array(module.ra_mean)
        elif isinstance(module, torch.nn.Linear):
            weight, bias = _array(module.weight), _array(module.bias)
            folded = (weight * gain, bias + (weight * offset).sum(axis=1))
            layers.append((folded[0].astype(np.float32), folded[1].astype(np.float32)))
            gain, offset = np.ones(1), np.zeros(1)
        elif not isinstance(module, torch.nn.ReLU):
            raise TypeError(f"cannot fold {type(module).__name__} into a plain policy")
    return Policy(tuple(layers), run)


def _parts(model: CrossQ) -> tuple[ReplayBuffer, torch.Tensor, VecEnv]:
    """What a learner built by `build` has, although SB3's types say it may not."""
    if model.replay_buffer is None or model.log_ent_coef is None or model.env is None:
        raise TypeError("expected a learner made by build()")
    return model.replay_buffer, model.log_ent_coef, model.env


def snapshot(model: CrossQ) -> dict[str, np.ndarray[Any, Any]]:
    """What SB3's own file leaves out: the filled part of the replay buffer, counters and random states."""
    buffer, log_ent_coef, _ = _parts(model)
    filled = buffer.buffer_size if buffer.full else buffer.pos
    generator = np.random.get_state(legacy=False)  # noqa: NPY002 - SB3 draws its batches from it
    return {
        **{name: getattr(buffer, name)[:filled] for name in _BUFFER_FIELDS},
        "position": np.array([buffer.pos, buffer.full]),
        "counters": np.array([model.num_timesteps, model._n_updates, model._episode_num]),
        "log_ent_coef": log_ent_coef.detach().cpu().numpy(),
        "torch_random": torch.get_rng_state().numpy(),
        "numpy_random": generator["state"]["key"],
        "numpy_random_position": np.array(generator["state"]["pos"]),
    }


def restore(model: CrossQ, kept: Callable[[str], np.ndarray[Any, Any]]) -> None:
    """Put a snapshot into a newly built learner whose weights have been set.

    Episodes in flight are lost: what the buffer holds of them ends in a time-out, and
    the environments start anew from a seed made of the run's and the step.
    """
    buffer, log_ent_coef, envs = _parts(model)
    for name in _BUFFER_FIELDS:
        values = kept(name)
        getattr(buffer, name)[: len(values)] = values
    buffer.pos, buffer.full = int(kept("position")[0]), bool(kept("position")[1])
    buffer.timeouts[buffer.pos - 1] = 1.0 - buffer.dones[buffer.pos - 1] * (1.0 - buffer.timeouts[buffer.pos - 1])
    model.num_timesteps, model._n_updates, model._episode_num = (int(one) for one in kept("counters"))
    with torch.no_grad():
        log_ent_coef.copy_(torch.as_tensor(kept("log_ent_coef")))
    fresh = int(np.random.SeedSequence([model.seed or 0, model.num_timesteps]).generate_state(1)[0] >> 1)
    random.seed(fresh)
    torch.manual_seed(fresh)  # of CUDA, whose state is not kept
    model.action_space.seed(fresh)
    envs.seed(fresh)
    torch.set_rng_state(torch.as_tensor(kept("torch_random")))
    state = np.random.get_state(legacy=False)  # noqa: NPY002 - SB3 draws its batches from it
    state["state"] = {"key": kept("numpy_random"), "pos": int(kept("numpy_random_position"))}
    np.random.set_state(state)  # noqa: NPY002


def _array(tensor: Any) -> np.ndarray[Any, Any]:  # noqa: ANN401 - a Tensor; torch types buffers loosely
    array: np.ndarray[Any, Any] = tensor.detach().cpu().numpy().astype(np.float64)
    return array
