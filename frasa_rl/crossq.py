"""CrossQ that learns fast: sb3-contrib's model and files, the updates of our own."""

import copy
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import torch
from gymnasium import spaces
from sb3_contrib import CrossQ
from sb3_contrib.common.torch_layers import BatchRenorm1d
from stable_baselines3.common.torch_layers import FlattenExtractor
from stable_baselines3.common.utils import update_learning_rate

from frasa_rl.batches import Batches
from frasa_rl.crossq_bind import Norms, norms_of
from frasa_rl.crossq_cpu import Data
from frasa_rl.crossq_gpu import Device
from frasa_rl.crossq_processor import Processor


@dataclass(frozen=True)
class Losses:
    """Means over the updates of a call; NaN where none of that kind was made.

    Attributes:
        critic: loss.
        actor: loss.
        entropy: coefficient.
        entropy_loss: of the coefficient; NaN where it is fixed, too.
    """

    critic: float
    actor: float
    entropy: float
    entropy_loss: float


class FastCrossQ(CrossQ):
    """sb3-contrib's CrossQ with its updates compiled: same arguments, same files, same numbers up to rounding.

    What the compiled updates do not know (`obstacle` says what) is learned by sb3-contrib's own `train`.

    Args:
        given: sb3-contrib's arguments.
        weight_norm: keep each hidden layer's weight at its first Frobenius norm (CrossQ + WN, arXiv 2502.07523): batch
            normalisation after it makes its length meaningless, but as it grows steps of a given size turn it less.
        more: sb3-contrib's arguments.

    Attributes:
        norms: those first norms, as `norms_of` says them; None until it learns, and without `weight_norm`. Weights that
            have learned have them but for rounding, so that a model that goes on needs these.
    """

    norms: dict[str, Norms] | None = None
    _learner: Processor | Device | None = None
    _engines: ClassVar[dict[str, type[Processor] | type[Device]]] = {"cpu": Processor, "cuda": Device}

    def __init__(self, *given: Any, weight_norm: bool = False, **more: Any) -> None:  # noqa: ANN401
        self.weight_norm = weight_norm
        super().__init__(*given, **more)

    @property
    def fast(self) -> bool:
        """Whether `train` is compiled; if not it is sb3-contrib's own."""
        return self.obstacle is None

    @property
    def obstacle(self) -> str | None:
        """What the compiled updates do not know of this model; none if they know all."""
        actor: Any = self.actor
        critic: Any = self.critic
        nets = [list(net) for net in (actor.latent_pi, *critic.q_networks)]
        modules = [module for net in nets for module in net]
        optimizers = [actor.optimizer, critic.optimizer]
        groups = [group for optimizer in optimizers for group in optimizer.param_groups]
        space, extractors = self.observation_space, [actor.features_extractor, critic.features_extractor]
        known: dict[str, Callable[[], bool]] = {
            "a device other than a processor or CUDA": lambda: self.device.type in self._engines,
            "state-dependent noise (gSDE)": lambda: not self.use_sde,
            "observations that are not one vector": lambda: isinstance(space, spaces.Box) and len(space.shape) == 1,
            "a features extractor": lambda: all(type(one) is FlattenExtractor for one in extractors),
            "an optimizer other than Adam": lambda: all(type(one) is torch.optim.Adam for one in optimizers),
            "weight decay, AMSGrad or parameter groups": lambda: (
                len(groups) == 2
                and not any(group[name] for group in groups for name in ("weight_decay", "amsgrad", "maximize"))
            ),
            "no batch renormalisation": lambda: any(isinstance(one, BatchRenorm1d) for one in modules),
            "an activation other than ReLU": lambda: all(
                isinstance(one, torch.nn.ReLU | torch.nn.Linear | BatchRenorm1d) for one in modules
            ),
            "a network without hidden layers": lambda: all(len(net) > 2 for net in nets),
        }
        return next((what for what, fine in known.items() if not fine()), None)

    def train(self, gradient_steps: int, batch_size: int = 64) -> None:
        """SB3's interface: draw from the replay buffer as sb3-contrib does, and learn.

        Raises:
            ValueError: `weight_norm` for a model that only sb3-contrib's own updates know.
        """
        if not self.fast:
            if self.weight_norm:
                raise ValueError(f"weight_norm needs compiled updates, which do not know {self.obstacle}")
            super().train(gradient_steps, batch_size)
            return
        self.policy.set_training_mode(True)
        self.actor.set_bn_training_mode(False)  # sb3-contrib leaves them so
        self.critic.set_bn_training_mode(False)
        self._update_learning_rate(self._optimizers())
        losses = self._learn(self._draw(gradient_steps, batch_size))
        self.logger.record("train/n_updates", self._n_updates, exclude="tensorboard")
        self.logger.record("train/ent_coef", losses.entropy)
        self.logger.record("train/critic_loss", losses.critic)
        if not np.isnan(losses.actor):
            self.logger.record("train/actor_loss", losses.actor)
        if not np.isnan(losses.entropy_loss):
            self.logger.record("train/ent_coef_loss", losses.entropy_loss)

    def update(self, batches: Batches) -> Losses:
        """As many updates as there are batches; no global generator is touched.

        Other threads run meanwhile; they must not use this model's tensors, which change.

        Raises:
            ValueError: a model that compiled updates do not know, a shape that does not fit, a number that is none.
        """
        if not self.fast:
            raise ValueError(f"the compiled updates do not know {self.obstacle}")
        for optimizer in self._optimizers():
            update_learning_rate(optimizer, self.lr_schedule(self._current_progress_remaining))
        return self._learn(batches)

    def set_parameters(self, load_path_or_dict: Any, *given: Any, **more: Any) -> None:  # noqa: ANN401
        """SB3's own, of a copy: torch would share another model's moments. The learner takes them up when it learns."""
        known = isinstance(load_path_or_dict, dict)
        super().set_parameters(copy.deepcopy(load_path_or_dict) if known else load_path_or_dict, *given, **more)
        self._learner = None

    def __deepcopy__(self, memo: dict[int, Any]) -> "FastCrossQ":
        """A copy that learns on its own: its tensors are no views until it does."""
        new = type(self).__new__(type(self))
        memo[id(self)] = new
        new.__dict__.update({k: copy.deepcopy(v, memo) for k, v in self.__dict__.items() if k != "_learner"})
        return new

    def _optimizers(self) -> list[torch.optim.Optimizer]:
        optimizers = [self.actor.optimizer, self.critic.optimizer]
        return optimizers if self.ent_coef_optimizer is None else [*optimizers, self.ent_coef_optimizer]

    def _kind(self) -> torch.dtype:
        kind: torch.dtype = self.critic.optimizer.param_groups[0]["params"][0].dtype
        return kind

    def _draw(self, count: int, size: int) -> Batches:
        """Batches and noise, from numpy's and torch's global generators in sb3-contrib's order."""
        if self.replay_buffer is None:
            raise TypeError("a model that has no environment has no replay buffer to learn from")
        acted, drawn = self.action_space.shape or (), []
        like: dict[str, Any] = {"dtype": self._kind(), "device": self.device}
        for update in range(self._n_updates + 1, self._n_updates + count + 1):
            data = self.replay_buffer.sample(size, env=self._vec_normalize_env)
            discounts = torch.full((size,), self.gamma, **like) if data.discounts is None else data.discounts
            next_noise = torch.empty((size, *acted), **like).normal_()
            learns = update % self.policy_delay == 0
            noise = torch.empty((size, *acted), **like).normal_() if learns else next_noise
            columns = [one.view(-1) for one in (data.rewards, data.dones, discounts)]
            drawn.append([data.observations, data.actions, data.next_observations, *columns, next_noise, noise])
        return Batches(*(torch.stack(parts).to(self._kind()).cpu().numpy() for parts in zip(*drawn, strict=True)))

    def _learn(self, batches: Batches) -> Losses:
        data = self._checked(batches)
        size = data[0].shape[1]
        if self._learner is None or self._learner.batch != size:
            if self.weight_norm and self.norms is None:
                self.norms = norms_of(self)
            self._learner = self._engines[self.device.type](self, size, self.norms)
        losses = self._learner.run(data, self._n_updates)
        self._n_updates += len(losses)
        known = [column[~np.isnan(column)] for column in losses.T]
        return Losses(*(float(column.mean()) if len(column) else float("nan") for column in known))

    def _checked(self, batches: Batches) -> Data:
        """The arrays, in memory as the compiled updates read them."""
        lead = np.shape(batches.observations)[:2]
        seen, acted = self.observation_space.shape, self.action_space.shape
        if seen is None or acted is None or len(lead) != 2 or 0 in lead:
            raise ValueError(f"observations of the batches have shape {np.shape(batches.observations)}")
        ends = (seen, acted, seen, (), (), (), acted, acted)
        kind = str(self._kind()).removeprefix("torch.")
        arrays = []
        for name, end in zip(Batches.__dataclass_fields__, ends, strict=True):
            array = np.ascontiguousarray(getattr(batches, name), kind)
            if array.shape != (*lead, *end):
                raise ValueError(f"{name} of the batches have shape {array.shape}: expected {(*lead, *end)}")
            with np.errstate(over="ignore", invalid="ignore"):
                if not np.isfinite(array.sum()):
                    raise ValueError(f"{name} of the batches hold a number that is not finite")
            arrays.append(array)
        observations, actions, following, rewards, dones, discounts, next_noise, noise = arrays
        return observations, actions, following, rewards, dones, discounts, next_noise, noise

    def _excluded_save_params(self) -> list[str]:
        return [*super()._excluded_save_params(), "_learner"]
