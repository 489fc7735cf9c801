"""Networks side by side as stacked tensors: batch renormalisation as arithmetic, one product for all of them."""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import torch

from frasa_rl.crossq_bind import Layer, Norms, View, bind

_MOST_RATIO, _MOST_SHIFT = 3.0, 5.0  # rmax and dmax of sb3-contrib
_PARTS = ("scale", "shift", "weight", "bias")


class Stacked(NamedTuple):
    """A batch renormalisation and the linear layer after it, of C networks.

    Attributes:
        scale, shift: of the normalisation, shape (C, inputs).
        weight, bias: of the linear layer, shapes (C, outputs, inputs) and (C, outputs).
        mean, var: running statistics, shape (C, inputs).
        steps: batches they have seen, shape (C,).
        epsilon, momentum, warmup: of the normalisation.
    """

    scale: torch.Tensor
    shift: torch.Tensor
    weight: torch.Tensor
    bias: torch.Tensor
    mean: torch.Tensor
    var: torch.Tensor
    steps: torch.Tensor
    epsilon: float
    momentum: float
    warmup: int


def _stacked(layers: Sequence[Layer]) -> Stacked:
    """Zeros for the same layer of several networks."""
    norm, heads = layers[0]
    count, inputs, outputs = len(layers), norm.num_features, sum(head.out_features for head in heads)

    def zeros(*shape: int) -> torch.Tensor:
        return norm.scale.detach().new_zeros((count, *shape))

    return Stacked(
        scale=zeros(inputs),
        shift=zeros(inputs),
        weight=zeros(outputs, inputs),
        bias=zeros(outputs),
        mean=zeros(inputs),
        var=zeros(inputs),
        steps=zeros().long(),
        epsilon=norm.eps,
        momentum=norm.momentum,
        warmup=norm.warmup_steps,
    )


class Stack:
    """Networks of one shape whose modules' and optimizer's tensors are views of stacked ones.

    Args:
        networks: the layers of each.
        optimizer: theirs.
    """

    def __init__(self, networks: Sequence[Sequence[Layer]], optimizer: torch.optim.Optimizer) -> None:
        self.networks, self.optimizer = networks, optimizer
        self.layers = [_stacked(layers) for layers in zip(*networks, strict=True)]
        self.leaves = [getattr(layer, part).requires_grad_() for layer in self.layers for part in _PARTS]
        self.first, self.second = ([torch.zeros_like(leaf) for leaf in self.leaves] for _ in range(2))
        owners = optimizer.param_groups[0]["params"]
        device = self.leaves[0].device
        self.steps = torch.zeros(len(owners), device=device)
        self.rate = torch.zeros((), dtype=torch.double, device=device)
        self.views = [*self._views(), *((owner, "step", self.steps[i]) for i, owner in enumerate(owners))]
        self.lengths: list[torch.Tensor] = []

    def _views(self) -> Iterator[View]:
        """Owner, name of its tensor and the place in ours that it has to be."""
        with torch.no_grad():
            for c, layers in enumerate(self.networks):
                for i, (norm, heads) in enumerate(layers):
                    layer, row = self.layers[i], 0
                    for name, tensor in (("ra_mean", layer.mean), ("ra_var", layer.var), ("steps", layer.steps)):
                        yield norm, name, tensor[c]
                    yield from self._parameter(norm.scale, 4 * i, c, slice(None))
                    yield from self._parameter(norm.bias, 4 * i + 1, c, slice(None))
                    for head in heads:
                        rows = slice(row, row + head.out_features)
                        yield from self._parameter(head.weight, 4 * i + 2, c, rows)
                        yield from self._parameter(head.bias, 4 * i + 3, c, rows)
                        row += head.out_features

    def _parameter(self, owner: torch.Tensor, leaf: int, c: int, rows: slice) -> Iterator[View]:
        for name, tensors in (("data", self.leaves), ("exp_avg", self.first), ("exp_avg_sq", self.second)):
            yield owner, name, tensors[leaf].detach()[c, rows]

    def bind(self) -> bool:
        """Put views of our tensors where torch has others, with the same numbers; whether there was any."""
        return bind(self.optimizer, self.views)

    def keep_norms(self, norms: Norms) -> None:
        """From now on each weight that a batch renormalisation follows has this Frobenius norm."""
        like = self.layers[0].weight.detach()
        self.lengths = [like.new_tensor(column).view(-1, 1, 1) for column in zip(*norms, strict=True)]

    def __call__(self, x: torch.Tensor, training: bool) -> torch.Tensor:
        """Outputs, shape (C, N, outputs), of inputs of shape (N, inputs) or (C, N, inputs)."""
        x = x.expand(len(self.networks), *x.shape[-2:])
        for i, layer in enumerate(self.layers):
            x = normalised(layer, x if i == 0 else torch.relu(x), training)
            x = torch.baddbmm(layer.bias[:, None], x, layer.weight.transpose(1, 2))
        return x

    def learn(self, loss: torch.Tensor) -> None:
        """Adam's step down a loss, as torch computes it, without a number leaving the device."""
        slopes = list(torch.autograd.grad(loss, self.leaves))
        group: dict[str, Any] = self.optimizer.param_groups[0]
        with torch.no_grad():
            self.steps += 1.0
            adam(self.leaves, slopes, (self.first, self.second), self.steps[0], self.rate, group)
            for layer, length in zip(self.layers, self.lengths, strict=False):
                layer.weight.mul_(length / layer.weight.norm(dim=(1, 2), keepdim=True))


def adam(
    values: list[torch.Tensor],
    slopes: list[torch.Tensor],
    moments: tuple[list[torch.Tensor], list[torch.Tensor]],
    step: torch.Tensor,
    rate: torch.Tensor,
    group: dict[str, Any],
) -> None:
    """Adam's step of several tensors at once.

    Args:
        values: parameters, changed.
        slopes: gradients.
        moments: first and second, changed.
        step: which step, from 1, shape ().
        rate: learning rate, shape ().
        group: the optimizer's betas and eps.
    """
    keep, keep_square, epsilon = (float(one) for one in (*group["betas"], group["eps"]))
    first, second = moments
    step = step.double()
    size, root = rate / (1.0 - keep**step), (1.0 - keep_square**step).sqrt()
    torch._foreach_lerp_(first, slopes, 1.0 - keep)
    torch._foreach_mul_(second, keep_square)
    torch._foreach_addcmul_(second, slopes, slopes, value=1.0 - keep_square)
    below = torch._foreach_sqrt(second)
    torch._foreach_div_(below, root.to(below[0].dtype))
    torch._foreach_add_(below, epsilon)
    steps = torch._foreach_div(first, below)
    torch._foreach_mul_(steps, size.to(below[0].dtype))
    torch._foreach_sub_(values, steps)


def normalised(layer: Stacked, x: torch.Tensor, training: bool) -> torch.Tensor:
    """Batch renormalisation of x, shape (C, N, inputs); in training running statistics are updated."""
    if not training:
        middle, spread = layer.mean, layer.var
    else:
        var, mean = torch.var_mean(x, dim=1)
        with torch.no_grad():
            ratio, shift = _corrections(layer, mean, var)
            layer.mean.add_(layer.momentum * (mean - layer.mean))
            layer.var.add_(layer.momentum * (var - layer.var))
            layer.steps.add_(1)
        # A column that never changes (a dead unit) has no slope of the root; torch would give 0 times infinity.
        varies = var > 0.0
        root = torch.where(varies, var, 1.0).sqrt() * varies
        middle, spread = mean - shift * root / ratio, var / ratio**2
    inverse = (spread + layer.epsilon).rsqrt()
    return (x - middle[:, None]) * inverse[:, None] * layer.scale[:, None] + layer.shift[:, None]


def _corrections(layer: Stacked, mean: torch.Tensor, var: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """How far the batch's deviation and mean are from the running ones, limited; 1 and 0 while warming up."""
    warm = (layer.steps > layer.warmup)[:, None]
    running = (layer.var + layer.epsilon).sqrt()
    ratio = ((var + layer.epsilon).sqrt() / running).clamp(1.0 / _MOST_RATIO, _MOST_RATIO)
    shift = ((mean - layer.mean) / running).clamp(-_MOST_SHIFT, _MOST_SHIFT)
    return torch.where(warm, ratio, 1.0), torch.where(warm, shift, 0.0)
