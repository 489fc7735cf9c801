"""The learner on a processor: torch's tensors on one side, the compiled updates on the other."""

from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from sb3_contrib.crossq.policies import Actor, CrossQCritic

from frasa_rl.crossq_bind import Bound, layers_of
from frasa_rl.crossq_cpu import Rules, updates
from frasa_rl.crossq_squash import room
from frasa_rl.crossq_vectors import PANEL, Array

Losses = npt.NDArray[np.float64]


class Processor:
    """Networks of a model bound to arrays, for batches of one size.

    Args:
        actor, critic: sb3-contrib's modules with their optimizers; their tensors become views.
        batch: transitions an update.
        delay: critic updates to one of the policy.
        target_entropy: of the entropy coefficient.
    """

    def __init__(self, actor: Actor, critic: CrossQCritic, batch: int, delay: int, target_entropy: float) -> None:
        heads = [actor.mu, actor.log_std]
        self.actor = Bound([layers_of(list(actor.latent_pi), heads)], actor.optimizer, batch)
        nets = [layers_of(list(net)) for net in critic.q_networks]
        self.critic = Bound(nets, critic.optimizer, 2 * batch)
        self.batch, self.delay, self.target_entropy = batch, delay, target_entropy
        self.dtype = self.actor.net.values.dtype
        widest = max(int(bound.net.table[:, :2].max()) for bound in (self.actor, self.critic))
        self._room = room(batch, int(actor.mu.out_features), widest, self.dtype)

    def __deepcopy__(self, memo: dict[int, Any]) -> None:
        """A copied model binds its own tensors when it learns."""

    def run(
        self, data: tuple[Array, ...], done: int, entropy: torch.Tensor, optimizer: torch.optim.Adam | None
    ) -> Losses:
        """All updates that the arrays hold, in the order of `Batches`.

        Args:
            done: updates made before.
            entropy: logarithm of the entropy coefficient, shape (1,).
            optimizer: its; none where it is fixed.

        Returns:
            Losses of critic and actor, entropy coefficient and its loss, shape (K, 4); NaN where there was no update.
        """
        self.actor.bind()
        self.critic.bind()
        state = _adam_state(optimizer, entropy)
        steps = np.array([self.actor.step, self.critic.step, float(state["step"])])
        losses = np.full((len(data[0]), 4), np.nan)
        lines = (entropy.detach().numpy(), np.zeros(1, self.dtype), *(state[name].numpy() for name in _MOMENTS))
        updates(self.actor.net, self.critic.net, lines, steps, done, data, self._rules(optimizer), self._room, losses)
        self.actor.step, self.critic.step = steps[0], steps[1]
        state["step"].fill_(steps[2])
        return losses

    def _rules(self, optimizer: torch.optim.Adam | None) -> Rules:
        return Rules(
            self.delay,
            self.target_entropy,
            optimizer is not None,
            _norm_rules(self.actor),
            _norm_rules(self.critic),
            _adam_rules(self.actor.optimizer),
            _adam_rules(self.critic.optimizer),
            _adam_rules(optimizer or self.actor.optimizer),
        )


_MOMENTS = ("exp_avg", "exp_avg_sq")


def _adam_state(optimizer: torch.optim.Adam | None, value: torch.Tensor) -> dict[str, torch.Tensor]:
    """What Adam knows of one tensor; zeros that it keeps from now on where it has made no step."""
    state = {} if optimizer is None else optimizer.state[value]
    if not state:
        state.update(step=torch.zeros(()), **{name: torch.zeros_like(value, requires_grad=False) for name in _MOMENTS})
    return state


def _adam_rules(optimizer: torch.optim.Optimizer) -> npt.NDArray[np.float64]:
    group = optimizer.param_groups[0]
    return np.array([float(group["lr"]), *(float(one) for one in group["betas"]), float(group["eps"])])


def _norm_rules(bound: Bound) -> Array:
    """What `normalise` takes."""
    norm = bound.stacked[0][0][0]
    return np.array([[one] * PANEL for one in (norm.eps, norm.momentum, norm.warmup_steps)], bound.net.values.dtype)
