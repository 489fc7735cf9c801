"""A task as text: YAML with a comment at every field, taken from the descriptions in `config` and `assumed`."""

import inspect
from dataclasses import fields, is_dataclass
from textwrap import wrap
from typing import Any

import yaml

from frasa_rl.config import Task

SCHEMA = "frasa.task/1"
_WIDTH = 116
# What a training preset has numbers of its own for, which a file of all fields must not undo. In Task and Reward.
OF_PRESETS = ("near_target_share", "near_target_push", "falling_share", "end_gyro", "gathering", "approach")
_PRESET = "Training presets have their own; a number here goes before theirs."
_HEAD = """\
# The stand-up task: which joints, poses, rates, rewards, ends, physics, and the ranges nobody has measured.
# This is the Sigmaban's, which every tool takes where no file is given. A file of your own (--task FILE) names
# only what differs from it. null means none. Units stand in brackets. What training presets have numbers of their own
# for is commented out.
"""


def task_data(task: Task) -> dict[str, Any]:
    """A task as plain data for YAML, the same that `task_file.task_from` takes."""
    return {"schema": SCHEMA, **_plain(task)}


def dump_task(task: Task, head: str = "") -> str:
    """A task as a YAML file that names every field; what presets of training choose is a comment unless it was changed.

    Args:
        task: what is written.
        head: comment lines at the beginning.
    """
    return f"{head}schema: {SCHEMA}\n" + "\n".join(_lines(task, 0)) + "\n"


def documented_default() -> str:
    """The content of `robot_model/standup.yaml`."""
    return dump_task(Task(), _HEAD)


def _plain(value: Any) -> Any:  # noqa: ANN401 - a dataclass of the task, or a value in it
    if is_dataclass(value):
        data = {one.name: _plain(getattr(value, one.name)) for one in fields(value)}
        return {name: one for name, one in data.items() if not (name in ("left", "right") and one is None)}
    if isinstance(value, tuple) and value and isinstance(value[0], tuple):
        return {str(name): float(one) for name, one in value}
    return [_plain(one) for one in value] if isinstance(value, tuple) else value


def _lines(value: Any, depth: int) -> list[str]:  # noqa: ANN401
    """A dataclass' fields, each below its description."""
    pad, said, lines = "  " * depth, _descriptions(type(value)), []
    for field in fields(value):
        one = getattr(value, field.name)
        left = field.name in OF_PRESETS and one == field.default
        comment = wrap(f"{said.get(field.name, '')} {_PRESET if left else ''}", _WIDTH - len(pad))
        lines += [f"{pad}# {line}" for line in comment]
        if is_dataclass(one) and not _leaf(one):
            lines += [f"{pad}{field.name}:", *_lines(one, depth + 1)]
        else:
            lines += [pad + ("# " if left else "") + line for line in _yaml(field.name, _plain(one))]
    return lines


def _leaf(value: Any) -> bool:  # noqa: ANN401
    """Whether a dataclass is written on a line, without comments: an assumed range is."""
    return hasattr(value, "source")


def _yaml(name: str, value: Any) -> list[str]:  # noqa: ANN401
    """A field on a line; of a list of mappings, a line for each of them."""
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return [f"{name}:", *(f"  - {_flow(one)}" for one in value)]
    return [f"{name}: {_flow(value)}"]


def _flow(value: Any) -> str:  # noqa: ANN401
    text = str(yaml.safe_dump(value, default_flow_style=True, width=1_000_000, sort_keys=False, allow_unicode=True))
    return text.removesuffix("\n").removesuffix("\n...").strip()


def _descriptions(kind: type) -> dict[str, str]:
    """The attributes of a dataclass with what its docstring says of them."""
    said: dict[str, str] = {}
    name = ""
    text = inspect.getdoc(kind) or ""
    for line in text.partition("Attributes:\n")[2].splitlines():
        indent = len(line) - len(line.lstrip())
        if indent == 4 and ":" in line:
            name, _, rest = line.strip().partition(":")
            said[name] = rest.strip()
        elif indent > 4 and name:
            said[name] += f" {line.strip()}"
    return {name: one.replace("`", "") for name, one in said.items()}
