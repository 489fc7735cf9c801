"""The same updates with torch on a GPU: nothing leaves the device within a call, and CUDA graphs hold many updates.

Tests run this code on a processor. What a graph needs is kept there too (fixed shapes, no number read back, tensors
that stay where they are), but `_Graph` itself has not run on a GPU yet.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from sb3_contrib import CrossQ

from frasa_rl.crossq_bind import Norms, View, bind, networks_of
from frasa_rl.crossq_cpu import ACTOR_LOSS, CRITIC_LOSS, ENTROPY, ENTROPY_LOSS, Data, Numbers
from frasa_rl.crossq_stack import Stack, adam

_LOG_STD_MIN, _LOG_STD_MAX = -20.0, 2.0  # of sb3-contrib's actor
_EPSILON = 1e-6  # of SB3's squashed Gaussian
_LOG_ROOT_TWO_PI = 0.5 * math.log(2.0 * math.pi)
_ROUNDS = 8  # of the policy's updates in a graph
Tensors = Sequence[torch.Tensor]


class Device:
    """Networks of a model bound to stacked tensors, for batches of one size.

    Args:
        model: its actor's, its critics' and their optimizers' tensors become views.
        batch: transitions an update.
        norms: Frobenius norms that weights of hidden layers are kept at, as `norms_of` says them; None for free ones.
    """

    def __init__(self, model: CrossQ, batch: int, norms: Mapping[str, Norms] | None) -> None:
        networks = networks_of(model)
        self._model, self.batch = model, batch
        self.actor = Stack(networks["actor"], model.actor.optimizer)
        self.critic = Stack(networks["critic"], model.critic.optimizer)
        leaf = self.critic.leaves[0]
        self.kind, self.device = leaf.dtype, leaf.device
        self.log_alpha, self.alpha_first, self.alpha_second = (
            torch.zeros(1, dtype=self.kind, device=self.device) for _ in range(3)
        )
        self.alpha_step = torch.zeros((), device=self.device)
        self.alpha_rate = torch.zeros((), dtype=torch.double, device=self.device)
        self._graph: _Graph | None = None
        self._bind()
        for name, stack in (("actor", self.actor), ("critic", self.critic)):
            if norms is not None:
                stack.keep_norms(norms[name])

    def _bind(self) -> None:
        """Take over tensors that were loaded since the last call; a graph of others is of no use."""
        changed = [stack.bind() for stack in (self.actor, self.critic)]
        owner, optimizer = self._model.log_ent_coef, self._model.ent_coef_optimizer
        if owner is None or optimizer is None:
            self.log_alpha.copy_(torch.log(self._model.ent_coef_tensor.double()))
        else:
            moments = ("exp_avg", self.alpha_first), ("exp_avg_sq", self.alpha_second)
            views: list[View] = [(owner, "data", self.log_alpha), *((owner, *one) for one in moments)]
            changed.append(bind(optimizer, [*views, (owner, "step", self.alpha_step)]))
            self.alpha_rate.fill_(optimizer.param_groups[0]["lr"])
        for stack in (self.actor, self.critic):
            stack.rate.fill_(stack.optimizer.param_groups[0]["lr"])
        if any(changed):
            self._graph = None

    def run(self, data: Data, done: int) -> Numbers:
        """All updates that the arrays hold.

        Args:
            data: arrays in the order of `Batches`.
            done: updates made before.

        Returns:
            Losses of critic and actor, entropy coefficient and its loss, shape (K, 4); NaN where there was no update.
        """
        self._bind()
        tensors = [torch.from_numpy(array).to(self.device, non_blocking=True) for array in data]
        losses = torch.full((len(data[0]), 4), math.nan, dtype=self.kind, device=self.device)
        delay, at = self._model.policy_delay, 0
        whole = _ROUNDS * delay
        while at < len(losses):
            if self._graph is not None and (done + at) % delay == 0 and at + whole <= len(losses):
                self._graph.replay([one[at : at + whole] for one in tensors], losses[at : at + whole])
                at += whole
                continue
            self.update([one[at] for one in tensors], (done + at + 1) % delay == 0, losses[at])
            at += 1
            if self.device.type == "cuda" and self._graph is None and at >= whole:  # warmed up
                self._graph = _Graph(self, [one[:whole] for one in tensors], delay)
        result: Numbers = losses.cpu().numpy().astype(np.float64)
        return result

    def update(self, batch: Tensors, with_policy: bool, losses: torch.Tensor) -> None:
        """One update; losses are written, shape (4,)."""
        observations, actions, following, rewards, dones, discounts, next_noise, noise = batch
        alpha = self.log_alpha.exp()
        with torch.no_grad():
            next_actions, next_log_probability = _draw(self.actor(following, training=False)[0], next_noise)
        pairs = torch.cat([torch.cat([observations, actions], 1), torch.cat([following, next_actions], 1)])
        q = self.critic(pairs, training=True)[..., 0]
        now, after = q[:, : len(rewards)], q[:, len(rewards) :]
        with torch.no_grad():
            value = after.min(dim=0).values - alpha * next_log_probability
            target = rewards + (1.0 - dones) * discounts * value
        loss = 0.5 * (now - target).square().mean(dim=1).sum()
        self.critic.learn(loss)
        losses[CRITIC_LOSS], losses[ENTROPY] = loss.detach(), alpha[0]
        if with_policy:
            self._update_policy(observations, noise, alpha, losses)

    def _update_policy(
        self, seen: torch.Tensor, noise: torch.Tensor, alpha: torch.Tensor, losses: torch.Tensor
    ) -> None:
        actions, log_probability = _draw(self.actor(seen, training=True)[0], noise)
        if self._model.ent_coef_optimizer is not None:
            self._update_entropy(log_probability.detach().mean() + float(self._model.target_entropy), losses)
        value = self.critic(torch.cat([seen, actions], 1), training=False)[..., 0].min(dim=0).values
        loss = (alpha * log_probability - value).mean()
        self.actor.learn(loss)
        losses[ACTOR_LOSS] = loss.detach()

    def _update_entropy(self, excess: torch.Tensor, losses: torch.Tensor) -> None:
        """The coefficient grows while actions are surer than the target entropy."""
        optimizer: Any = self._model.ent_coef_optimizer
        losses[ENTROPY_LOSS] = -self.log_alpha[0] * excess
        self.alpha_step += 1.0
        moments = [self.alpha_first], [self.alpha_second]
        group = optimizer.param_groups[0]
        adam([self.log_alpha], [-excess.view(1)], moments, self.alpha_step, self.alpha_rate, group)


def _draw(output: torch.Tensor, noise: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Actions and their log probability from mean and log deviation side by side, as SB3 computes it."""
    mean, log_std = output.chunk(2, dim=1)
    log_std = log_std.clamp(_LOG_STD_MIN, _LOG_STD_MAX)
    actions = torch.tanh(mean + log_std.exp() * noise)
    density = -0.5 * noise.square() - log_std - _LOG_ROOT_TWO_PI - torch.log(1.0 - actions.square() + _EPSILON)
    return actions, density.sum(dim=1)


class _Graph:
    """Several updates, ending with one of the policy, recorded once and replayed as one launch.

    Recording runs nothing, so it changes no weights; eager updates before it have warmed everything up.
    """

    def __init__(self, learner: Device, like: Tensors, delay: int) -> None:
        self._inputs = [torch.empty_like(one) for one in like]
        self._losses = torch.full((len(like[0]), 4), math.nan, dtype=learner.kind, device=learner.device)
        self._graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(self._graph):
            for i in range(len(like[0])):
                learner.update([one[i] for one in self._inputs], (i + 1) % delay == 0, self._losses[i])

    def replay(self, data: Tensors, losses: torch.Tensor) -> None:
        for place, new in zip(self._inputs, data, strict=True):
            place.copy_(new)
        self._graph.replay()
        losses.copy_(self._losses)
