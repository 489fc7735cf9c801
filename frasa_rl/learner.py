"""Learners: what the training loop asks of one, our CrossQ, and SAC of stable-baselines3 to compare with."""

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol, cast

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from sb3_contrib.common.torch_layers import BatchRenorm1d
from stable_baselines3 import SAC
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.type_aliases import ReplayBufferSamples

from frasa_rl.actor import ActorLayers, Layer
from frasa_rl.batches import Batches
from frasa_rl.crossq import FastCrossQ
from frasa_rl.crossq_bind import Norms, norms_of
from frasa_rl.observation import Observation
from frasa_rl.policy import Array
from frasa_rl.settings import Settings
from frasa_rl.snapshots import Arrays, nested, part
from frasa_sysid.calibration import UsageError


class Learner(Protocol):
    """Learns from batches; a run keeps and restores all of it."""

    @property
    def updates(self) -> int:
        """Gradient updates so far."""

    @property
    def device(self) -> str:
        """What it computes on."""

    def update(self, batches: Batches) -> None:
        """One gradient update on each batch."""

    def actor(self) -> ActorLayers:
        """The policy as it is now; a copy."""

    def log_to(self, logger: Logger) -> None:
        """Where it reports its own numbers."""

    def save(self) -> bytes:
        """Weights and optimizer states, as SB3's file."""

    def load(self, file: Path) -> None:
        """The other way round."""

    def snapshot(self) -> Arrays:
        """What that file leaves out: counters, the entropy coefficient, random states."""

    def restore(self, kept: Mapping[str, np.ndarray[Any, Any]]) -> None:
        """The other way round."""


class _Spaces(gymnasium.Env[Observation, Array]):
    """What SB3 wants to know of an environment; it is never stepped."""

    def __init__(self, bound: Observation, joints: int) -> None:
        self.observation_space = spaces.Box(-bound, bound, dtype=np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (joints,), dtype=np.float32)


class _Given:
    """Stands in for a replay buffer: gives the batches it was given, one after the other."""

    def __init__(self, batches: Batches, device: torch.device) -> None:
        self._batches, self._device, self._next = batches, device, 0

    def sample(self, batch_size: int, env: object = None) -> ReplayBufferSamples:
        """The next one; its size is its own."""
        k, self._next = self._next, self._next + 1
        given = self._batches
        columns = (given.dones[k, :, None], given.rewards[k, :, None], given.discounts[k, :, None])
        arrays = (given.observations[k], given.actions[k], given.next_observations[k], *columns)
        return ReplayBufferSamples(*(torch.as_tensor(one, device=self._device) for one in arrays))


class Sb3Learner:
    """CrossQ, which takes all batches at once where it can; or SAC of SB3, its update as it stands."""

    def __init__(self, model: FastCrossQ | SAC) -> None:
        self.model = model
        self.log_to(Logger(None, []))

    @property
    def updates(self) -> int:
        """Gradient updates so far."""
        return int(self.model._n_updates)

    @property
    def device(self) -> str:
        """What it computes on."""
        return str(self.model.device.type)

    def update(self, batches: Batches) -> None:
        """One gradient update on each batch."""
        if isinstance(self.model, FastCrossQ) and self.model.fast:
            losses = self.model.update(batches)
            told = {"critic_loss": losses.critic, "actor_loss": losses.actor, "ent_coef": losses.entropy}
            for name, value in told.items():
                if np.isfinite(value):
                    self.model.logger.record(f"train/{name}", value)
            return
        many, size = batches.rewards.shape
        self.model.replay_buffer = cast(ReplayBuffer, _Given(batches, self.model.device))
        self.model.train(many, size)

    def actor(self) -> ActorLayers:
        """The policy as it is now; a copy.

        Batch renormalisation at inference is a x + c with a = scale / sqrt(var + eps) and
        c = bias - a mean, so W (a x + c) + b = (W a) x + (W c + b).
        """
        actor: Any = self.model.actor  # SB3 types its parts as any module
        hidden: list[Layer] = []
        gain, offset = np.ones(1), np.zeros(1)
        for module in actor.latent_pi:
            if isinstance(module, BatchRenorm1d):
                gain = _array(module.scale) / np.sqrt(_array(module.ra_var) + module.eps)
                offset = _array(module.bias) - gain * _array(module.ra_mean)
            elif isinstance(module, torch.nn.Linear):
                hidden.append(_folded(module, gain, offset))
                gain, offset = np.ones(1), np.zeros(1)
            elif not isinstance(module, torch.nn.ReLU):
                raise TypeError(f"cannot fold {type(module).__name__} into linear layers")
        mean, log_std = (_folded(one, gain, offset) for one in (actor.mu, actor.log_std))
        return ActorLayers(tuple(hidden), mean, log_std)

    def log_to(self, logger: Logger) -> None:
        """Where it reports its own numbers."""
        self.model.set_logger(logger)

    def save(self) -> bytes:
        """Weights and optimizer states, as SB3's file."""
        content = io.BytesIO()
        self.model.save(content)
        return content.getvalue()

    def load(self, file: Path) -> None:
        """The other way round; only tensors are read, nothing is unpickled."""
        self.model.set_parameters(str(file), device=self.model.device)

    def snapshot(self) -> Arrays:
        """What that file leaves out: counters, the entropy coefficient, random states."""
        random = {"torch_random": torch.get_rng_state().numpy()}
        if self.model.device.type == "cuda":
            random["cuda_random"] = torch.cuda.get_rng_state(self.model.device).numpy()
        return {
            "updates": np.array(self.updates),
            "log_ent_coef": self._entropy().detach().cpu().numpy().copy(),
            **nested("norms", {name: np.array(one) for name, one in (self._norms() or {}).items()}),
            **random,
        }

    def restore(self, kept: Mapping[str, np.ndarray[Any, Any]]) -> None:
        """The other way round.

        Raises:
            ValueError: it is of other networks.
        """
        if isinstance(self.model, FastCrossQ):  # older checkpoints have no norms: they become those of the weights now
            self.model.norms = _checked(part("norms", kept), norms_of(self.model)) if self.model.weight_norm else None
        self.model._n_updates = int(kept["updates"])
        with torch.no_grad():
            self._entropy().copy_(torch.as_tensor(kept["log_ent_coef"]))
        torch.set_rng_state(torch.as_tensor(kept["torch_random"]))
        if self.model.device.type == "cuda" and "cuda_random" in kept:
            torch.cuda.set_rng_state(torch.as_tensor(kept["cuda_random"]), self.model.device)

    def _norms(self) -> dict[str, Norms] | None:
        """What `weight_norm` keeps."""
        return self.model.norms if isinstance(self.model, FastCrossQ) else None

    def _entropy(self) -> torch.Tensor:
        """The logarithm of the coefficient, which adapts in all that `build` makes."""
        if self.model.log_ent_coef is None:
            raise TypeError("expected a learner whose entropy coefficient adapts")
        return self.model.log_ent_coef


def computes_on(device: str) -> str:
    """What `auto`, `cpu` or `cuda` comes to on this machine: `cpu`, or `cuda` with the name of the GPU.

    Raises:
        UsageError: `cuda` without a CUDA device.
    """
    there = torch.cuda.is_available()
    if device == "cuda" and not there:
        raise UsageError("no CUDA device that torch can use: give --device cpu")
    return "cpu" if device == "cpu" or not there else f"cuda ({torch.cuda.get_device_name()})"


def build(settings: Settings, bound: Observation, joints: int, device: str) -> Learner:
    """A new learner; all its chance is of the settings' seed.

    Args:
        settings: of it.
        bound: largest magnitude of every observed number, shape (observed,).
        joints: numbers of an action.
        device: `auto`, `cpu` or `cuda`.

    Raises:
        UsageError: `cuda` without a CUDA device.
    """
    computes_on(device)
    torch.set_num_threads(settings.threads)
    nets: dict[str, Any] = {"net_arch": {"pi": list(settings.actor), "qf": list(settings.critic)}}
    common: dict[str, Any] = {
        "learning_rate": settings.learning_rate,
        "buffer_size": 1,  # ours is outside
        "batch_size": settings.batch,
        "gamma": settings.discount,
        "ent_coef": f"auto_{settings.entropy}",
        "target_entropy": settings.target_entropy * joints,
        "seed": settings.seed,
        "device": device,
    }
    env = _Spaces(bound, joints)
    if settings.algorithm == "sac":
        return Sb3Learner(SAC("MlpPolicy", env, policy_kwargs=nets, **common))
    # CrossQ's own first moment; fused where torch itself has to learn (what the compiled updates do not know).
    nets |= {"renorm_warmup_steps": settings.renorm_warmup, "optimizer_kwargs": {"betas": (0.5, 0.999), "fused": True}}
    common |= {"policy_delay": settings.policy_delay, "weight_norm": settings.weight_norm}
    return Sb3Learner(FastCrossQ("MlpPolicy", env, policy_kwargs=nets, **common))


def _checked(kept: Arrays, now: dict[str, Norms]) -> dict[str, Norms] | None:
    """Kept norms, which are those of the weights now but for rounding; None for none.

    Raises:
        ValueError: they are not.
    """
    if not kept:
        return None
    for name, norms in now.items():
        if np.shape(kept[name]) != np.shape(norms) or not np.allclose(kept[name], norms, rtol=1e-2):
            raise ValueError(f"the norms of the {name}'s weights are not those of its weights")
    return {name: kept[name].tolist() for name in now}


def _folded(module: torch.nn.Linear, gain: np.ndarray[Any, Any], offset: np.ndarray[Any, Any]) -> Layer:
    weight, bias = _array(module.weight), _array(module.bias)
    return (weight * gain).astype(np.float32), (bias + (weight * offset).sum(axis=1)).astype(np.float32)


def _array(tensor: Any) -> np.ndarray[Any, Any]:  # noqa: ANN401 - a Tensor; torch types buffers loosely
    array: np.ndarray[Any, Any] = tensor.detach().cpu().numpy().astype(np.float64)
    return array
