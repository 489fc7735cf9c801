"""The policy that a run publishes: the best of its evaluations, also of a run that ended and then went on."""

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from frasa_rl.deployment import deployment
from frasa_rl.export import publish
from frasa_rl.plan import Plan
from frasa_rl.policy import FOLDER, Policy
from frasa_rl.snapshots import Arrays


class Published:
    """The policy folder of a run, and the policy that an unbroken run would have there.

    They differ after a run went on from an end. The evaluation that was made there is dropped, yet its policy stays
    published until the next evaluation; the best of those that count follows.

    Args:
        plan: of the run.
        description: of the run, which its policies carry.
    """

    def __init__(self, plan: Plan, description: dict[str, Any]) -> None:
        self._plan, self._description = plan, description
        self._best: Policy | None = None  # of the evaluations that an unbroken run has, too
        self._ahead = False  # another one is published

    def best(self, policy: Policy, *, due: bool) -> None:
        """Publish what did best so far.

        Args:
            policy: that did.
            due: its evaluation was, and not only made because the run ended.
        """
        self._publish(policy)
        self._ahead = False
        if due:
            self._best = policy

    def no_better(self) -> None:
        """An evaluation found none better than the best: that one is published, if another was."""
        if self._ahead and self._best is not None:
            self._publish(self._best)
            self._ahead = False

    def newest(self, policy: Policy) -> None:
        """Publish a policy as long as none was evaluated."""
        if not self._ahead:
            self._publish(policy)

    def stay(self) -> None:
        """The evaluation of what is published was dropped."""
        self._ahead = True

    def _publish(self, policy: Policy) -> None:
        """With all that a robot must know to run it."""
        plan = self._plan
        publish(policy, deployment(policy.run, plan.task, plan.model), plan.out / FOLDER)

    def snapshot(self) -> Arrays:
        """For a checkpoint."""
        kept: Arrays = {"ahead": np.array(self._ahead)}
        if self._best is not None:
            for i, (weight, bias) in enumerate(self._best.layers):
                kept |= {f"weight{i}": weight, f"bias{i}": bias}
            kept["trained"] = np.array(json.dumps(self._best.run["trained"]))
        return kept

    def restore(self, kept: Mapping[str, np.ndarray[Any, Any]]) -> None:
        """The other way round; older checkpoints have nothing of it.

        Raises:
            PolicyError: these are no layers.
        """
        self._ahead, self._best = bool(kept.get("ahead", False)), None
        if "trained" in kept:
            count = sum(name.startswith("weight") for name in kept)
            layers = tuple((kept[f"weight{i}"], kept[f"bias{i}"]) for i in range(count))
            self._best = Policy(layers, {**self._description, "trained": json.loads(str(kept["trained"]))})
