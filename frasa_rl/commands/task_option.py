"""`--task FILE`, which every command of frasa-rl takes the same way."""

import argparse
from pathlib import Path
from typing import Any

from frasa_rl.config import Task
from frasa_rl.policy import Policy
from frasa_rl.task_file import load_task, task_from


def add_task_option(parser: argparse.ArgumentParser, default: str = "the policy's own, else the Sigmaban's") -> None:
    """Give a command `--task`."""
    parser.add_argument("--task", type=Path, metavar="FILE", help=f"names, poses, rates, ranges (default: {default})")


def chosen_task(args: argparse.Namespace, policy: Policy | None = None) -> Task:
    """The task that the arguments name: a file's, else the one a policy was trained on, else the Sigmaban's.

    Raises:
        TaskError: the file, or what the policy's run.yaml says, is no task.
    """
    if args.task is not None:
        return load_task(args.task)
    return Task() if policy is None else task_of_run(policy.run)


def task_of_run(run: dict[str, Any]) -> Task:
    """The task that a run.yaml speaks of; the Sigmaban's where it says nothing.

    Raises:
        TaskError: it is no task of this version.
    """
    return task_from(run.get("task", {}), "run.yaml")
