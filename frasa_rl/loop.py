"""Rounds of training: robots are stepped while the learner learns from what they did before.

In a round the robots act as the policy was at its beginning, and the learner draws from what was there at its
beginning: whoever is faster waits, so that the result is the same on any machine, however busy it is.
"""

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any

import numpy as np

from frasa_rl.actor import Average
from frasa_rl.collector import Collector, Round
from frasa_rl.learner import Learner
from frasa_rl.policy import Policy
from frasa_rl.replay import Replay
from frasa_rl.settings import Settings
from frasa_rl.snapshots import Arrays, nested, part
from frasa_sysid.calibration import FrasaError

_AT_ONCE = 64  # batches drawn together; more only need more memory


class LearnerError(FrasaError):
    """The learner has no finite numbers any more."""


class Loop:
    """A learner, its robots, and what they did.

    Attributes:
        learner: learns.
        collector: has the robots.
        replay: what they did.
        steps: transitions so far.

    Args:
        settings: how they go together.
        learner: nobody else's, as the others are.
        collector: of `settings.envs` robots.
        replay: of as many.
    """

    def __init__(self, settings: Settings, learner: Learner, collector: Collector, replay: Replay) -> None:
        self.learner, self.collector, self.replay = learner, collector, replay
        self.steps = 0
        self._settings = settings
        self._average = Average(settings.average)
        self._actor = learner.actor()  # folded once for robots and average: on a GPU it is a synchronisation
        self._average.follow(self._actor, 0)
        self._beside = ThreadPoolExecutor(1, "collector")

    def round(self) -> Round:
        """Gather a round's transitions, and make its updates once there is enough to learn from."""
        steps, updates = self._settings.rounds
        starting = self.steps < self._settings.learning_starts
        actor = None if starting else self._actor
        if self._settings.overlap and not starting and len(self.replay):
            gathering = self._beside.submit(self.collector.collect, actor, steps)
            try:
                self._learn(updates)
            finally:
                wait([gathering])  # physics must not go on while an error or a signal ends the run
            got = gathering.result()
            self._keep(got)
        else:
            got = self.collector.collect(actor, steps)
            self._keep(got)
            if not self._settings.overlap and self.steps >= self._settings.learning_starts:
                self._learn(updates)
        self.collector.episodes.curriculum.note(self.steps, got.success)
        return got

    def _learn(self, updates: int) -> None:
        while updates > 0:
            many = min(updates, _AT_ONCE)
            self.learner.update(self.replay.draw(many, self._settings.batch))
            self._actor = self.learner.actor()
            self._check_finite()
            self._average.follow(self._actor, many)
            updates -= many

    def _check_finite(self) -> None:
        """Raise LearnerError where the policy is no policy any more."""
        actor = self._actor
        if not all(np.isfinite(part).all() for layer in (*actor.hidden, actor.mean, actor.log_std) for part in layer):
            raise LearnerError(
                f"the learner diverged: after {self.learner.updates:,} updates its policy holds numbers that are not "
                "finite; what was saved before is there, and a smaller learning_rate (--set) is what to try"
            )

    def _keep(self, got: Round) -> None:
        self.replay.add(got.transitions)
        self.steps += got.transitions.rewards.size

    def policy(self, run: dict[str, Any]) -> Policy:
        """What has been learned so far, to be tried and published."""
        return self._average.policy(run)

    def snapshot(self) -> Arrays:
        """All of it but what the learner saves itself, for a checkpoint."""
        return {
            "steps": np.array(self.steps),
            **nested("learner", self.learner.snapshot()),
            **nested("collector", self.collector.snapshot()),
            **nested("replay", self.replay.snapshot()),
            **nested("average", self._average.snapshot()),
        }

    def restore(self, kept: Mapping[str, np.ndarray[Any, Any]]) -> None:
        """The other way round.

        Raises:
            KeyError: something is missing.
            ValueError: it is of other settings.
        """
        self.collector.restore(part("collector", kept))
        self.replay.restore(part("replay", kept))
        self.learner.restore(part("learner", kept))
        self._actor = self.learner.actor()
        self._average.restore(part("average", kept))
        self.steps = int(kept["steps"])

    def close(self) -> None:
        """End the threads."""
        self._beside.shutdown()
        self.collector.episodes.close()
