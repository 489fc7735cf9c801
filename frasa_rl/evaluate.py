"""The paper's tables for any controller on any model: which controller, all trials, what they come to."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from frasa_rl.config import Task
from frasa_rl.controllers import Controller, Nothing, PolicyController
from frasa_rl.foreign import foreign_policy, is_foreign
from frasa_rl.instruments import MEASURES
from frasa_rl.keyframe import KEYFRAMES as KEYFRAMES_FILE
from frasa_rl.keyframe import load_controller
from frasa_rl.model_path import NAMED, check_there, model_path, run_folder
from frasa_rl.observation import layout
from frasa_rl.policy import Policy, PolicyError
from frasa_rl.protocol import PAPER_PUSH, PAPER_STANDUP, SIDES, Conditions, mean_and_std
from frasa_rl.protocol_push import PushTrial, run_push
from frasa_rl.protocol_standup import StandUpTrial, run_standup
from frasa_rl.robot import find_robot
from frasa_rl.task_model import build_model
from frasa_sysid.calibration import CalibrationError, calibration_id, load_model, model_sha256, say

SCHEMA = "frasa.evaluation/2"
NOTHING, KEYFRAMES = "nothing", "keyframes"
DEFAULT_MODEL = Path("robot_model/calibrated.xml")


@dataclass(frozen=True)
class Evaluation:
    """All trials of a controller under some conditions.

    Attributes:
        standup: prone first.
        push: front first, then by energy.
    """

    standup: list[StandUpTrial]
    push: list[PushTrial]

    def to_dict(self) -> dict[str, Any]:
        """The tables as plain data, each row with the times of its trials and of the paper."""
        sides = {side: [one for one in self.standup if one.side == side] for side in SIDES}
        cells = dict.fromkeys((one.direction, one.energy_j) for one in self.push)
        rows = [[one for one in self.push if (one.direction, one.energy_j) == cell] for cell in cells]
        all_trials: list[StandUpTrial | PushTrial] = [*self.standup, *(one for one in self.push if one.hit)]
        strain = np.array([one.strain for one in all_trials]).mean(axis=0) if all_trials else None
        return {
            "standup": {side: _standup_row(row) for side, row in sides.items() if row},
            "push": [_push_row(row) for row in rows],
            "strain": {} if strain is None else {one.name: v for one, v in zip(MEASURES, strain, strict=True)},
            "divergences": sum(one.diverged for one in self.standup) + sum(one.diverged for one in self.push),
        }


def _standup_row(row: Sequence[StandUpTrial]) -> dict[str, Any]:
    times = [one.time_s for one in row]
    mean, std = mean_and_std(times)
    return {
        "trials": len(row),
        "success_rate": sum(one is not None for one in times) / len(row),
        "time_mean_s": mean,
        "time_std_s": std,
        "from_decision_mean_s": mean_and_std([one.from_decision_s for one in row])[0],
        "times_s": times,
        "paper_s": PAPER_STANDUP[row[0].side],
    }


def _push_row(row: Sequence[PushTrial]) -> dict[str, Any]:
    times = [one.time_s for one in row]
    mean, std = mean_and_std(times)
    return {
        "direction": row[0].direction,
        "energy_j": row[0].energy_j,
        "trials": len(row),
        "success_rate": sum(one is not None for one in times) / len(row),
        "instability_mean_s": mean,
        "instability_std_s": std,
        "falls": sum(one.fell for one in row),
        "not_standing": sum(not one.stood for one in row),
        "missed": sum(one.stood and not one.hit for one in row),
        "impulse_mean_ns": mean_and_std([one.impulse if one.hit else None for one in row])[0],
        "times_s": times,
        "paper_s": PAPER_PUSH.get((row[0].direction, row[0].energy_j)),
    }


def evaluate(
    controller: Controller,
    conditions: Conditions,
    standup: int,
    push: int,
    tell: Callable[[float], None] = lambda _: None,
) -> Evaluation:
    """Run the protocol.

    Args:
        controller: what tells the robots what to do.
        conditions: model, rate, randomization, seed.
        standup: trials a side; 0 for none.
        push: trials of each push; 0 for none.
        tell: called with the share done.

    Raises:
        ModelError: the model is broken or lacks something.
        CalibrationError: its ranges are missing or belong to another.
        UsageError: the rate does not fit the task.
    """
    share = 0.25 if standup and push else float(bool(standup))
    stood = run_standup(controller, conditions, standup, lambda x: tell(share * x)) if standup else []
    pushed = run_push(controller, conditions, push, lambda x: tell(share + (1 - share) * x)) if push else []
    return Evaluation(stood, pushed)


def find_controller(
    word: str, model: Path | None, task: Task, *, allow_other_model: bool = False, trust: bool = False
) -> tuple[Controller, Path]:
    """The controller a word names, and the model it is to run on.

    Args:
        word: `nothing`, `keyframes`, a file of keyframes (.yaml), the folder of a run or policy, or an SB3 file (.zip).
        model: None for the one the policy was trained on, or the calibrated one.
        task: what it is to do.
        allow_other_model: a policy may run on another calibration than its own.
        trust: an SB3 file may be read.

    Raises:
        PolicyError: no policy there, one of another task, or an SB3 file that is not trusted.
        KeyframeError: no keyframes there, or with joints or angles that the model does not have.
        ModelError: the model that keyframes are to run on is missing or broken, or lacks something.
        CalibrationError: a policy of another calibration, or of another nominal model, and that is not allowed.
    """
    if word == NOTHING:
        return Nothing(task), model or DEFAULT_MODEL
    if not is_policy(word):
        chosen = model or DEFAULT_MODEL
        limits_deg = np.degrees(find_robot(build_model(chosen, task), task).limits)
        path = KEYFRAMES_FILE if word == KEYFRAMES else Path(word)
        return load_controller(path, task, limits_deg), chosen
    policy, chosen = find_policy(word, model, task, allow_other_model=allow_other_model, trust=trust)
    return PolicyController(policy, word), chosen


def find_policy(
    word: str, model: Path | None, task: Task, *, allow_other_model: bool = False, trust: bool = False
) -> tuple[Policy, Path]:
    """The policy a word names, and its model; arguments and errors as in `find_controller`."""
    if is_foreign(word):
        chosen = model or DEFAULT_MODEL
        policy = foreign_policy(Path(word), task, chosen, trust=trust)
    else:
        policy = Policy.load(word)
        chosen = model or _own_model(policy, Path(word))
    loaded = load_model(chosen)
    check_policy(policy, task, calibration_id(loaded), allow_other_model=allow_other_model)
    if calibration_id(loaded) is None and not allow_other_model:  # no id that says what it is
        check_model(policy.run, model_sha256(loaded), chosen)
    return policy, chosen


def check_model(run: dict[str, Any], found: str, path: Path) -> None:
    """Raise when a policy was trained on another model than this one, as far as that can be known.

    Args:
        run: run.yaml of the policy.
        found: `model_sha256` of the model.
        path: of the model, for the message.

    Raises:
        CalibrationError: the same MuJoCo compiles to another model than in training.
    """
    trained_on, versions = run.get("model_sha256"), run.get("versions")
    if trained_on in (None, found):
        return
    before = versions.get("mujoco") if isinstance(versions, dict) else None
    if before == mujoco.__version__:
        raise CalibrationError(
            f"{path} is not the model the policy was trained on, or was changed since: give that one with --model, or "
            "--allow-other-model"
        )
    say(f"{path}: not compared with the policy's beyond its calibration id, as that was made with MuJoCo {before}")


def _own_model(policy: Policy, folder: Path) -> Path:
    """The model that a policy was trained on."""
    said = {**policy.run, NAMED: str(policy.run.get(NAMED, DEFAULT_MODEL))}
    path = model_path(said, run_folder(folder))
    check_there(path)
    return path


def is_policy(word: str) -> bool:
    """Whether a word for a controller names a policy: a folder, or an SB3 file."""
    return word not in (NOTHING, KEYFRAMES) and not word.endswith((".yaml", ".yml"))


def check_policy(policy: Policy, task: Task, calibration: str | None, *, allow_other_model: bool = False) -> None:
    """Raise when a policy does not belong to a task on a model.

    Args:
        policy: with what it was trained on in its run.yaml.
        task: what it is to do.
        calibration: id that the model carries; None for a nominal one.
        allow_other_model: whether it may be another than in training.

    Raises:
        PolicyError: it was trained on another task, or sees or moves another number of things.
        CalibrationError: it was trained on another calibration, and that is not allowed.
    """
    inputs, outputs = policy.layers[0][0].shape[1], policy.layers[-1][0].shape[0]
    wanted = (sum(part.size for part in layout(task)), len(task.joints))
    if (inputs, outputs) != wanted:
        raise PolicyError(
            f"the policy sees {inputs} numbers and moves {outputs}; the task has {wanted[0]}, {wanted[1]}"
        )
    said = policy.run.get("task")
    said = said if isinstance(said, dict) else {}
    joints = [one.get("name") for one in said.get("joints", [])]
    if joints != [one.name for one in task.joints] or said.get("rate_limit") != task.rate_limit:
        raise PolicyError("the policy was trained on another task (joints or rate limit differ)")
    trained_on = policy.run.get("calibration_id")
    if trained_on != calibration and not allow_other_model:
        raise CalibrationError(
            f"the policy was trained on calibration {trained_on or 'none (nominal)'}, "
            f"the model carries {calibration or 'none (nominal)'}; pass --allow-other-model to mean it"
        )
