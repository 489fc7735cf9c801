"""Torch modules and optimizers whose tensors are views of the learner's own arrays."""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import torch
from sb3_contrib import CrossQ
from sb3_contrib.common.torch_layers import BatchRenorm1d

from frasa_rl.crossq_net import BIAS, IN, SCALE, SHIFT, STATISTIC, WEIGHT, Net, network

Layer = tuple[BatchRenorm1d, list[torch.nn.Linear]]
View = tuple[Any, str, torch.Tensor]
Norms = list[list[float]]  # of a weight each, by network and layer
_STATE = ("step", "exp_avg", "exp_avg_sq")  # of torch's Adam


def layers_of(modules: Iterable[torch.nn.Module], heads: Sequence[torch.nn.Linear] = ()) -> list[Layer]:
    """Each batch renormalisation with the linear layer after it; heads side by side are one layer."""
    given = list(modules)
    norms = [module for module in given if isinstance(module, BatchRenorm1d)]
    linear = [[module] for module in given if isinstance(module, torch.nn.Linear)]
    return list(zip(norms, [*linear, list(heads)] if heads else linear, strict=True))


def networks_of(model: CrossQ) -> dict[str, list[list[Layer]]]:
    """The layers of a model's actor and of its critics."""
    actor: Any = model.actor
    critics: Iterable[Any] = model.critic.q_networks
    return {
        "actor": [layers_of(actor.latent_pi, [actor.mu, actor.log_std])],
        "critic": [layers_of(net) for net in critics],
    }


def norms_of(model: CrossQ) -> dict[str, Norms]:
    """The Frobenius norm of each weight that a batch renormalisation follows, as it is now."""
    return {
        name: [[float(heads[0].weight.detach().norm()) for _, heads in layers[:-1]] for layers in networks]
        for name, networks in networks_of(model).items()
    }


def bind(optimizer: torch.optim.Optimizer, views: Iterable[View]) -> bool:
    """Put views where torch has tensors of its own, with the same numbers; whether there was any."""
    changed = False
    with torch.no_grad():
        for owner, name, view in views:
            now = _now(optimizer, owner, name)
            if now is not None and now.data_ptr() == view.data_ptr():
                continue
            changed = True
            view.zero_() if now is None else view.copy_(now)
            if name in _STATE:
                optimizer.state[owner][name] = view
            else:
                setattr(owner, name, view)
    return changed


def _now(optimizer: torch.optim.Optimizer, owner: Any, name: str) -> torch.Tensor | None:  # noqa: ANN401
    """The tensor that torch works on; none for an optimizer that has made no step."""
    if name in _STATE:
        state: torch.Tensor | None = optimizer.state[owner].get(name)
        return state
    tensor: torch.Tensor = owner if name == "data" else getattr(owner, name)
    return tensor


class Bound:
    """A `Net` and the modules and the optimizer that look at its arrays.

    Args:
        stacked: the layers of each of the networks side by side.
        optimizer: theirs.
        rows: most rows of a batch.
    """

    def __init__(self, stacked: Sequence[Sequence[Layer]], optimizer: torch.optim.Optimizer, rows: int) -> None:
        first = stacked[0]
        widths = [norm.num_features for norm, _ in first]
        widths.append(sum(head.out_features for head in first[-1][1]))
        self.stacked, self.optimizer = stacked, optimizer
        self.net: Net = network(widths, len(stacked), rows, first[0][0].scale.detach().numpy().dtype)
        self.parameters: list[torch.nn.Parameter] = optimizer.param_groups[0]["params"]
        self.steps = torch.zeros(len(self.parameters))
        self.views = [*self._views(), *((one, "step", self.steps[i]) for i, one in enumerate(self.parameters))]

    def _views(self) -> Iterator[View]:
        """Owner, name of its tensor and the place in our arrays that it has to be."""
        for c, layers in enumerate(self.stacked):
            for layer, (norm, heads) in enumerate(layers):
                row = self.net.table[layer]
                yield from self._parameter(c, norm.scale, int(row[SCALE]))
                yield from self._parameter(c, norm.bias, int(row[SHIFT]))
                weight, bias = int(row[WEIGHT]), int(row[BIAS])
                for head in heads:
                    yield from self._parameter(c, head.weight, weight)
                    yield from self._parameter(c, head.bias, bias)
                    weight, bias = weight + head.weight.numel(), bias + head.bias.numel()
                start, end = int(row[STATISTIC]), int(row[STATISTIC] + row[IN])
                yield norm, "ra_mean", torch.from_numpy(self.net.mean[c, start:end])
                yield norm, "ra_var", torch.from_numpy(self.net.var[c, start:end])
                yield norm, "steps", torch.from_numpy(self.net.steps[c, layer : layer + 1]).view(())

    def _parameter(self, c: int, owner: torch.Tensor, start: int) -> Iterator[View]:
        lines = {"data": self.net.values, "exp_avg": self.net.first, "exp_avg_sq": self.net.second}
        for name, line in lines.items():
            yield owner, name, torch.from_numpy(line[c, start : start + owner.numel()]).view(owner.shape)

    def bind(self) -> None:
        """Put views of our arrays where torch has tensors of its own, with the same numbers."""
        bind(self.optimizer, self.views)

    def keep_norms(self, norms: Norms) -> None:
        """From now on each weight that a batch renormalisation follows has this Frobenius norm."""
        self.net.radius[:, :-1] = norms

    @property
    def step(self) -> float:
        """Steps that the optimizer has made."""
        return float(self.steps[0])

    @step.setter
    def step(self, count: float) -> None:
        self.steps.fill_(count)
