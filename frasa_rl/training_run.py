"""One training, from its first round to its last."""

import shutil
import time
from contextlib import suppress
from typing import Any

import numpy as np
import yaml
from stable_baselines3.common.logger import configure

from frasa_rl.checkpoint import FOLDER as CHECKPOINTS
from frasa_rl.checkpoint import load_checkpoint, save_checkpoint
from frasa_rl.evaluations import Evaluations, shown
from frasa_rl.held_out import HeldOut
from frasa_rl.loop import Loop
from frasa_rl.plan import Plan, mark_of
from frasa_rl.policy import FOLDER, RUN_FILE, Policy
from frasa_rl.progress import Progress
from frasa_rl.published import Published
from frasa_rl.snapshots import Arrays, nested, part
from frasa_rl.stopping import Interrupt
from frasa_sysid.calibration import InterruptedRunError, say, write_atomic

LATEST = "latest"


class Run:
    """A run on its way."""

    def __init__(self, plan: Plan, description: dict[str, Any], loop: Loop) -> None:
        self._plan, self._description, self._loop = plan, description, loop
        self._settings, self._mark = plan.settings, mark_of(description)
        self._logger = configure(str(plan.out / "tensorboard"), ["tensorboard"])
        loop.learner.log_to(self._logger)
        self._progress = Progress(plan.out, plan.ends, self._logger.record, self._logger.dump)
        self._evaluations = Evaluations(plan.out, plan.until_success)
        self._published = Published(plan, description)
        self._held_out: HeldOut | None = None
        self._interrupt = Interrupt()
        self._saved_at = 0

    def close(self) -> None:
        """End TensorBoard's thread, its file whole where there is room for that."""
        with suppress(OSError):
            self._logger.close()

    def go(self, *, resume: bool) -> dict[str, Any]:
        """Train until the run is over.

        Args:
            resume: from the last checkpoint.

        Returns:
            What the command says at the end.

        Raises:
            InterruptedRunError: Ctrl-C; everything is saved.
        """
        out = self._plan.out
        if resume:
            load_checkpoint(out, self._mark, self._loop.learner.load, self._restore)
            self._saved_at = self._loop.steps
            self._go_on()
        else:  # the first one comes before run.yaml: what says it is a run can be resumed
            shutil.rmtree(out / CHECKPOINTS, ignore_errors=True)
            self._progress.start(0.0)
            self._save()
        write_atomic(out / RUN_FILE, yaml.safe_dump(self._description, sort_keys=False))
        say(f"{'going on' if resume else 'training'} in {out} on {self._loop.learner.device}, model {self._plan.model}")
        with self._interrupt.watch():
            stopped = self._rounds()
        self._progress.add_row()
        self._progress.show()
        with suppress(ModuleNotFoundError):  # the curve is drawn where matplotlib is installed
            from frasa_rl.curve import draw_curve

            draw_curve(out)
        if stopped == "interrupted":
            raise InterruptedRunError(f"interrupted; saved in {out}, continue with --resume {out}")
        return self._result(stopped)

    def _rounds(self) -> str:
        """Until the run is over: why it is."""
        while True:
            over = self._over()
            if over != "interrupted" and (self._due or (over is not None and self._untried)):
                self._evaluate()
                over = self._over()
            if over is not None or self._loop.steps - self._saved_at >= self._settings.checkpoint_steps:
                self._save()
            if over is not None:
                return over
            got = self._loop.round()
            self._progress.note(self._loop.steps, self._loop.learner.updates, got)

    def _over(self) -> str | None:
        if self._interrupt.asked:
            return "interrupted"
        if self._evaluations.holds:
            return "success"
        return self._plan.ends.reached(self._loop.steps, self._progress.elapsed_s)

    @property
    def _due(self) -> bool:
        """Whether an evaluation is: counted in steps, so that a resumed run has the same ones."""
        each, before, now = self._settings.evaluate_steps, self._evaluations.evaluated_steps, self._loop.steps
        return each > 0 and now // each > before // each

    @property
    def _untried(self) -> bool:
        """Whether the present policy was not evaluated, as the last of a run is."""
        return self._settings.evaluate_steps > 0 and self._loop.steps > self._evaluations.evaluated_steps

    def _go_on(self) -> None:
        """After an end, what an unbroken run would not have is dropped."""
        over = self._plan.ends.reached(self._loop.steps, self._progress.elapsed_s)
        if over is None and self._evaluations.drop_early(self._settings.evaluate_steps):
            self._published.stay()
        self._remark()

    def _evaluate(self) -> None:
        """Let the present policy try held-out falls; publish it when it is the best so far."""
        begun, due = time.monotonic(), self._due
        if self._held_out is None:
            plan, settings = self._plan, self._settings
            self._held_out = HeldOut(plan.model, plan.task, settings.evaluate_falls, settings.evaluate_physics)
        policy = self._loop.policy({})
        got = self._held_out.run(policy, self._evaluations.next_set)
        minutes = self._progress.elapsed_s / 60.0
        if self._evaluations.add(self._loop.steps, minutes, got.prone, got.supine, got.time_s):
            held_out = {"prone": got.prone, "supine": got.supine, "time_s": got.time_s, "physics": self._physics}
            self._published.best(self._policy(policy, {"held_out": held_out}), due=due)
        else:
            self._published.no_better()
        for name in ("prone", "supine", "success", "time_s"):
            if np.isfinite(getattr(got, name)):
                self._logger.record(f"held_out/{name}", getattr(got, name))
        self._logger.record("run/evaluation_s", time.monotonic() - begun)
        self._logger.dump(self._loop.steps)
        self._remark()

    @property
    def _physics(self) -> str:
        return self._settings.evaluate_physics

    def _remark(self) -> None:
        last = self._evaluations.last
        self._progress.remark = "" if last is None else shown(last)

    def _policy(self, policy: Policy, more: dict[str, Any]) -> Policy:
        """A policy that says how it was trained."""
        trained = {"steps": self._loop.steps, "minutes": self._progress.elapsed_s / 60.0, **more}
        return Policy(policy.layers, {**self._description, "trained": trained})

    def _save(self) -> None:
        """A checkpoint, and the newest policy, which is the published one as long as none was evaluated."""
        begun = time.monotonic()
        state = {
            **self._loop.snapshot(),
            **nested("progress", self._progress.snapshot()),
            **nested("evaluations", self._evaluations.snapshot()),
            **nested("published", self._published.snapshot()),
        }
        save_checkpoint(self._plan.out, self._loop.steps, self._mark, self._loop.learner.save(), state)
        newest = self._policy(self._loop.policy({}), {})
        newest.save(self._plan.out / LATEST)
        if self._evaluations.best is None:
            self._published.newest(newest)
        self._saved_at = self._loop.steps
        self._logger.record("run/checkpoint_s", time.monotonic() - begun)

    def _restore(self, kept: Arrays) -> None:
        self._loop.restore(kept)
        self._progress.restore(part("progress", kept))
        self._evaluations.restore(part("evaluations", kept))
        self._published.restore(part("published", kept))

    def _result(self, stopped: str) -> dict[str, Any]:
        returns = [row[2] for row in self._progress.rows if np.isfinite(row[2])]
        best = self._evaluations.best
        return {
            "schema": "frasa.train/1",
            "run": self._plan.out,
            "policy": self._plan.out / FOLDER,
            "steps": self._loop.steps,
            "updates": self._loop.learner.updates,
            "minutes": self._progress.elapsed_s / 60.0,
            "return_first": returns[0] if returns else None,
            "return_last": returns[-1] if returns else None,
            "return_best": max(returns, default=None),
            "held_out": None if best is None else told(best),
            "stopped": stopped,
        }


def told(row: list[float]) -> dict[str, Any]:
    """The best policy's evaluation for --json."""
    steps, _, _, prone, supine, time_s, _ = row
    return {
        "steps": int(steps),
        "success_prone": prone,
        "success_supine": supine,
        "time_mean_s": time_s if np.isfinite(time_s) else None,
    }
