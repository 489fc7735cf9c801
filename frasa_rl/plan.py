"""What a run is: its model, task, settings and ends, and the run.yaml that says all of it."""

import platform
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import yaml

from frasa_rl import __version__
from frasa_rl.config import Task
from frasa_rl.held_out import SEED
from frasa_rl.model_path import FROM_RUN, NAMED, from_run, model_path
from frasa_rl.observation import layout
from frasa_rl.physics import with_physics
from frasa_rl.policy import RUN_FILE, read_run
from frasa_rl.settings import Settings
from frasa_rl.stopping import Ends
from frasa_rl.task_file import task_from
from frasa_rl.task_text import task_data
from frasa_sysid.calibration import InputError, UsageError, calibration_id, load_model, model_sha256, plain, sha256_of

SCHEMA = "frasa.run/2"
_PACKAGES = ("mujoco", "numpy", "numba", "gymnasium", "stable-baselines3", "sb3-contrib", "torch")
_NO_MATTER = ("threads", "env_threads", "checkpoint_steps")  # to what a run comes to


@dataclass(frozen=True)
class Plan:
    """What to train, for how long, and where to.

    Attributes:
        model: a model file.
        out: the run folder.
        settings: of learning.
        steps, minutes, until_success: the run ends at whichever comes first (`Ends`); None for no limit.
        device: `auto`, `cpu` or `cuda`.
        task: what is trained; its shares of starts, spin limit, leading rewards and physics are those of the
            settings.
    """

    model: Path
    out: Path
    settings: Settings
    steps: int | None = None
    minutes: float | None = None
    until_success: float | None = None
    device: str = "auto"
    task: Task = field(default_factory=Task)

    def __post_init__(self) -> None:
        Ends(self.steps, self.minutes, self.until_success)  # says what cannot be before anything is made
        own = self.settings
        task = replace(
            self.task,
            near_target_share=own.near_target_share,
            near_target_push=own.near_target_push,
            falling_share=own.falling_share,
            end_gyro=own.end_gyro,
            reward=own.reward(self.task.reward),
        )
        object.__setattr__(self, "task", with_physics(task, own.physics))

    @property
    def ends(self) -> Ends:
        """When the run is over."""
        return Ends(self.steps, self.minutes, self.until_success)

    def check_ends(self) -> None:
        """Raise UsageError when there is no end, or one that never comes."""
        if self.steps is None and self.minutes is None and self.until_success is None:
            raise UsageError("a run needs an end: give --minutes, --steps or --until-success")
        if self.ends.success is not None and not self.settings.evaluate_steps:
            raise UsageError("--until-success needs evaluations: give --evaluate-steps more than 0")

    def until(self, steps: int | None, minutes: float | None, until_success: float | None = None) -> "Plan":
        """The same plan with other ends, where one is given."""
        if steps is None and minutes is None and until_success is None:
            return self
        return replace(self, steps=steps, minutes=minutes, until_success=until_success)


def describe(plan: Plan, curriculum: str = "Curriculum") -> dict[str, Any]:
    """What run.yaml says: all that determines the run, in plain data.

    Args:
        plan: of the run.
        curriculum: name of the class that chooses starts and pays; the default is the task as it is.
    """
    model, task = load_model(plan.model), plan.task
    said: dict[str, Any] = plain(
        {
            "schema": SCHEMA,
            NAMED: plan.model,
            FROM_RUN: from_run(plan.model, plan.out),
            "model_sha256": model_sha256(model),
            "calibration_id": calibration_id(model),
            "steps": plan.steps,
            "minutes": plan.minutes,
            "until_success": plan.until_success,
            "device": plan.device,
            "seeds": {"training": plan.settings.seed, "held_out": SEED},
            "settings": asdict(plan.settings),
            "curriculum": curriculum,
            "observation": [{"name": one.name, "size": one.size, "unit": one.unit} for one in layout(task)],
            "task": task_data(task),
            "versions": {
                "frasa": __version__,
                "python": platform.python_version(),
                **{name: version(name) for name in _PACKAGES},
            },
        }
    )
    return said


def mark_of(description: dict[str, Any]) -> str:
    """Hash of what a run comes to: runs with the same one can resume from each other's checkpoints."""
    settings = {name: one for name, one in description["settings"].items() if name not in _NO_MATTER}
    names = ("model_sha256", "calibration_id", "task", "curriculum")
    said = [*(description[name] for name in names), settings]
    return sha256_of(yaml.safe_dump(said).encode())


def plan_of(run: Path) -> Plan:
    """The plan that a run folder was started with.

    Raises:
        PolicyError: no run.yaml there.
        InputError: one that this version cannot read.
    """
    return plan_from(read_run(run / RUN_FILE), run, str(run / RUN_FILE))


def plan_from(said: Mapping[str, Any], out: Path, where: str) -> Plan:
    """The plan that a description speaks of.

    Args:
        said: what `describe` returned, or was read from where it was written.
        out: the run folder.
        where: it was read, for errors.

    Raises:
        InputError: one that this version cannot read.
    """
    try:
        if said["schema"] != SCHEMA:
            raise ValueError(f"schema '{said['schema']}', expected '{SCHEMA}'")
        settings: dict[str, Any] = {
            name: tuple(one) if isinstance(one, list) else one for name, one in said["settings"].items()
        }
        return Plan(
            model=model_path(said, out),
            out=out,
            settings=Settings(**settings),
            steps=said["steps"],
            minutes=said["minutes"],
            until_success=said["until_success"],
            device=said["device"],
            task=task_from(said["task"], where),
        )
    except UsageError as error:  # said by a file, it is no mistake on the command line
        raise InputError(f"{where}: {error}") from error
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise InputError(f"{where}: missing or wrong field: {error!r}") from error
