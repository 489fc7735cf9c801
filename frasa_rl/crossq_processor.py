"""The learner on a processor: torch's tensors on one side, the compiled updates on the other."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from sb3_contrib import CrossQ

from frasa_rl.crossq_bind import Bound, Norms, networks_of
from frasa_rl.crossq_cpu import Data, Rules, updates
from frasa_rl.crossq_disk import fill
from frasa_rl.crossq_squash import room
from frasa_rl.crossq_vectors import PANEL, Array

Losses = npt.NDArray[np.float64]
_MOMENTS = ("exp_avg", "exp_avg_sq")


class Processor:
    """Networks of a model bound to arrays, for batches of one size.

    Args:
        model: its actor's, its critics' and their optimizers' tensors become views.
        batch: transitions an update.
        norms: Frobenius norms that weights of hidden layers are kept at, as `norms_of` says them; None for free ones.
    """

    def __init__(self, model: CrossQ, batch: int, norms: Mapping[str, Norms] | None) -> None:
        actor: Any = model.actor
        networks = networks_of(model)
        self._model, self.batch = model, batch
        self.actor = Bound(networks["actor"], model.actor.optimizer, batch)
        self.critic = Bound(networks["critic"], model.critic.optimizer, 2 * batch)
        widest = max(int(bound.net.table[:, :2].max()) for bound in (self.actor, self.critic))
        self.dtype = self.actor.net.values.dtype
        self._room = room(batch, actor.mu.out_features, widest, self.dtype)
        for name, bound in (("actor", self.actor), ("critic", self.critic)):
            bound.bind()
            if norms is not None:
                bound.keep_norms(norms[name])

    def run(self, data: Data, done: int) -> Losses:
        """All updates that the arrays hold.

        Args:
            data: arrays in the order of `Batches`.
            done: updates made before.

        Returns:
            Losses of critic and actor, entropy coefficient and its loss, shape (K, 4); NaN where there was no update.
        """
        self.actor.bind()
        self.critic.bind()
        entropy = self._model.log_ent_coef
        value = torch.from_numpy(np.zeros(1, self.dtype)) if entropy is None else entropy.detach()
        state = _adam_state(self._model.ent_coef_optimizer, entropy, value)
        steps = np.array([self.actor.step, self.critic.step, float(state["step"])])
        losses = np.full((len(data[0]), 4), np.nan)
        first, second = (state[name].numpy() for name in _MOMENTS)
        lines = value.numpy(), np.zeros(1, self.dtype), first, second
        if self.dtype == np.float32:
            fill(updates)
        updates(self.actor.net, self.critic.net, lines, steps, done, data, self._rules(), self._room, losses)
        self.actor.step, self.critic.step = steps[0], steps[1]
        state["step"].fill_(steps[2])
        return losses

    def _rules(self) -> Rules:
        model = self._model
        tuned = model.ent_coef_optimizer is not None
        return Rules(
            delay=model.policy_delay,
            target_entropy=float(model.target_entropy),
            tuned=tuned,
            fixed=0.0 if tuned else float(model.ent_coef_tensor),
            actor_norm=_norm_rules(self.actor),
            critic_norm=_norm_rules(self.critic),
            actor_adam=_adam_rules(model.actor.optimizer),
            critic_adam=_adam_rules(model.critic.optimizer),
            entropy_adam=_adam_rules(model.ent_coef_optimizer or model.actor.optimizer),
        )


def _adam_state(
    optimizer: torch.optim.Adam | None, owner: torch.Tensor | None, value: torch.Tensor
) -> dict[str, torch.Tensor]:
    """What Adam knows of the entropy coefficient; zeros, which it keeps, where it has made no step."""
    state: dict[str, torch.Tensor] = {} if optimizer is None or owner is None else optimizer.state[owner]
    if not state:
        state.update({"step": torch.zeros(()), **{name: torch.zeros_like(value) for name in _MOMENTS}})
    return state


def _adam_rules(optimizer: torch.optim.Optimizer) -> npt.NDArray[np.float64]:
    group = optimizer.param_groups[0]
    return np.array([float(group["lr"]), *(float(one) for one in group["betas"]), float(group["eps"])])


def _norm_rules(bound: Bound) -> Array:
    """What `normalise` takes."""
    norm = bound.stacked[0][0][0]
    return np.array([[one] * PANEL for one in (norm.eps, norm.momentum, norm.warmup_steps)], bound.net.values.dtype)
