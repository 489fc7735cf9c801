"""CrossQ that learns fast: sb3-contrib's model and files, the updates of our own."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from gymnasium import spaces
from sb3_contrib import CrossQ
from sb3_contrib.common.torch_layers import BatchRenorm1d
from stable_baselines3.common.torch_layers import FlattenExtractor
from stable_baselines3.common.utils import update_learning_rate

from frasa_rl.batches import Batches
from frasa_rl.crossq_processor import Processor


@dataclass(frozen=True)
class Losses:
    """Means over the updates of a call; NaN where none of that kind was made.

    Attributes:
        critic, actor: losses.
        entropy: the entropy coefficient.
        entropy_loss: its loss; NaN where it is fixed, too.
    """

    critic: float
    actor: float
    entropy: float
    entropy_loss: float


class FastCrossQ(CrossQ):  # type: ignore[misc]
    """sb3-contrib's CrossQ with its updates compiled: same arguments, same files, same numbers up to rounding.

    What the compiled updates do not know (`obstacle` says what) is learned by sb3-contrib's own `train`.
    """

    _processor: Processor | None = None

    @property
    def fast(self) -> bool:
        """Whether `train` is compiled; if not it is sb3-contrib's own."""
        return self.obstacle is None

    @property
    def obstacle(self) -> str | None:
        """What the compiled updates do not know of this model; none if they know all."""
        actor, critic = self.actor, self.critic
        modules = [*actor.latent_pi, *(module for net in critic.q_networks for module in net)]
        groups = [group for optimizer in (actor.optimizer, critic.optimizer) for group in optimizer.param_groups]
        known = {
            "another device than a processor": self.device.type == "cpu",
            "state-dependent noise (gSDE)": not self.use_sde,
            "observations that are no vector": isinstance(self.observation_space, spaces.Box)
            and len(self.observation_space.shape) == 1,
            "another features extractor": isinstance(actor.features_extractor, FlattenExtractor)
            and isinstance(critic.features_extractor, FlattenExtractor),
            "an optimizer other than Adam": all(type(one.optimizer) is torch.optim.Adam for one in (actor, critic)),
            "weight decay, AMSGrad or groups in Adam": len(groups) == 2
            and not any(group["weight_decay"] or group["amsgrad"] or group["maximize"] for group in groups),
            "no batch renormalisation": any(isinstance(one, BatchRenorm1d) for one in modules),
            "an activation other than ReLU": all(
                isinstance(one, torch.nn.ReLU | torch.nn.Linear | BatchRenorm1d) for one in modules
            ),
            "no hidden layer": all(len(net) > 2 for net in (actor.latent_pi, *critic.q_networks)),
        }
        return next((what for what, fine in known.items() if not fine), None)

    def train(self, gradient_steps: int, batch_size: int = 64) -> None:
        """SB3's interface: draw from the replay buffer as sb3-contrib does, and learn."""
        if not self.fast:
            super().train(gradient_steps, batch_size)
            return
        self.policy.set_training_mode(True)
        optimizers = [self.actor.optimizer, self.critic.optimizer]
        if self.ent_coef_optimizer is not None:
            optimizers.append(self.ent_coef_optimizer)
        self._update_learning_rate(optimizers)
        losses = self._learn(self._draw(gradient_steps, batch_size))
        self.logger.record("train/n_updates", self._n_updates, exclude="tensorboard")
        self.logger.record("train/ent_coef", losses.entropy)
        self.logger.record("train/critic_loss", losses.critic)
        if not np.isnan(losses.actor):
            self.logger.record("train/actor_loss", losses.actor)
        if not np.isnan(losses.entropy_loss):
            self.logger.record("train/ent_coef_loss", losses.entropy_loss)

    def _draw(self, count: int, size: int) -> Batches:
        """Batches and noise, from numpy's and torch's global generators in sb3-contrib's order."""
        drawn = []
        kind = self.actor.mu.weight.dtype
        shape = (size, int(self.actor.mu.out_features))
        for update in range(self._n_updates + 1, self._n_updates + count + 1):
            data = self.replay_buffer.sample(size, env=self._vec_normalize_env)
            discounts = data.discounts if data.discounts is not None else torch.full((size, 1), self.gamma, dtype=kind)
            next_noise = torch.empty(shape, dtype=kind).normal_()
            noise = torch.empty(shape, dtype=kind).normal_() if update % self.policy_delay == 0 else next_noise
            columns = [data.rewards, data.dones, discounts]
            matrices = [data.observations, data.actions, data.next_observations]
            drawn.append([*matrices, *(one.view(-1) for one in columns), next_noise, noise])
        return Batches(*(torch.stack(parts).to(kind).numpy() for parts in zip(*drawn, strict=True)))

    def update(self, batches: Batches) -> Losses:
        """As many updates as there are batches; other threads run meanwhile, no global generator is touched.

        Raises:
            ValueError: a shape that does not fit, or a number that is none.
        """
        if not self.fast:
            raise ValueError(f"the compiled updates do not know {self.obstacle}")
        optimizers = [self.actor.optimizer, self.critic.optimizer]
        if self.ent_coef_optimizer is not None:
            optimizers.append(self.ent_coef_optimizer)
        for optimizer in optimizers:
            update_learning_rate(optimizer, self.lr_schedule(self._current_progress_remaining))
        return self._learn(batches)

    def _learn(self, batches: Batches) -> Losses:
        data = self._checked(batches)
        size = data[0].shape[1]
        if self._processor is None or self._processor.batch != size:
            self._processor = Processor(self.actor, self.critic, size, self.policy_delay, float(self.target_entropy))
        fixed = self.log_ent_coef is None
        entropy = torch.log(self.ent_coef_tensor).view(1) if fixed else self.log_ent_coef
        losses = self._processor.run(data, self._n_updates, entropy, self.ent_coef_optimizer)
        self._n_updates += len(losses)
        known = [column[~np.isnan(column)] for column in losses.T]
        return Losses(*(float(column.mean()) if len(column) else float("nan") for column in known))

    def _checked(self, batches: Batches) -> tuple[npt.NDArray[Any], ...]:
        """The arrays, in memory as the compiled updates read them."""
        seen, count = self.observation_space.shape[0], self.action_space.shape[0]
        lead = np.shape(batches.observations)[:2]
        names = list(Batches.__dataclass_fields__)
        ends = dict(zip(names, ((seen,), (count,), (seen,), (), (), (), (count,), (count,)), strict=True))
        for name, end in ends.items():
            array = getattr(batches, name)
            if array.shape != (*lead, *end) or len(lead) != 2 or 0 in lead:
                raise ValueError(f"{name} of the batches have shape {array.shape}: expected {(*lead, *end)}")
            if not np.isfinite(array.sum()):
                raise ValueError(f"{name} of the batches hold a number that is not finite")
        kind = np.dtype(str(self.actor.mu.weight.dtype).removeprefix("torch."))
        return tuple(np.ascontiguousarray(getattr(batches, name), kind) for name in names)

    def _excluded_save_params(self) -> list[str]:
        return [*super()._excluded_save_params(), "_processor"]
