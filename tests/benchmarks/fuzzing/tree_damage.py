"""Damage to the values of a tree (JSON, JSON lines, YAML): other types, other sizes, lost, doubled, nested."""

import json
import random
from typing import Any

import yaml

VALUES: tuple[Any, ...] = (
    None, True, False, 0, 1, -1, 0.0, -0.5, 1e308, -1e308, 5e-324, float("nan"), float("inf"), float("-inf"), 2**31,
    2**63, 10**30, 10**400, 1e9, 10**9, "", "x", "nan", "1", "../../x", "/dev/zero", "\x00", "a" * 5000, "é\u2028",
    "\ud800", [], {}, [[]], [{}], {"a": 1}, [1, 2, 3], [None], ["x"], [float("nan")], {"": None}, [0.0] * 1000,
)  # fmt: skip
Place = tuple[Any, Any]  # a list or mapping, and the index or key in it


def damage_tree(content: bytes, name: str, rng: random.Random) -> bytes | None:
    """A damaged copy, or None where it is no tree."""
    try:
        if name.endswith(".jsonl"):
            lines = content.splitlines()
            at = rng.randrange(len(lines))
            lines[at] = json.dumps(_damaged(json.loads(lines[at]), rng)).encode()
            return b"\n".join(lines)
        if name.endswith(".yaml"):
            tree = _damaged(yaml.safe_load(content), rng)
            return yaml.dump(tree, Dumper=_Plain, sort_keys=False).encode("utf-8", "replace")
        return json.dumps(_damaged(json.loads(content), rng)).encode()
    except (ValueError, RecursionError, yaml.YAMLError, OverflowError, TypeError):
        return None


class _Plain(yaml.SafeDumper):
    """Without aliases: values that stand twice are written twice."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def _damaged(tree: Any, rng: random.Random) -> Any:
    places = _places(tree)
    if not places or rng.random() < 0.02:
        return rng.choice(VALUES)
    for _ in range(rng.choice((1, 1, 2, 5))):
        holder, key = rng.choice(places)
        _change(holder, key, rng)
    return tree


def _places(tree: Any) -> list[Place]:
    found: list[Place] = []
    open_ = [tree]
    while open_ and len(found) < 3000:
        one = open_.pop()
        inside = list(one.items()) if isinstance(one, dict) else list(enumerate(one)) if isinstance(one, list) else []
        # Of a long list the first few stand for all.
        for key, value in inside if isinstance(one, dict) else inside[:8]:
            found.append((one, key))
            open_.append(value)
    return found


def _change(holder: Any, key: Any, rng: random.Random) -> None:
    if isinstance(holder, list) and not 0 <= key < len(holder):
        return
    if isinstance(holder, dict) and key not in holder:
        return
    value, kind = holder[key], rng.randrange(9)
    if kind < 4:
        holder[key] = rng.choice(VALUES)
    elif kind == 4:
        del holder[key]
    elif kind == 5 and isinstance(value, int | float) and not isinstance(value, bool):
        holder[key] = -value
    elif kind == 6 and isinstance(value, list):
        holder[key] = value * 2 if rng.random() < 0.5 else value[: len(value) // 2]
    elif kind == 7:
        nested: Any = value
        for _ in range(rng.choice((1, 5, 90))):
            nested = [nested] if rng.random() < 0.5 else {"a": nested}
        holder[key] = nested
    elif isinstance(holder, dict):
        holder[rng.choice(("", "x", "__class__", key, "a" * 2000)) if isinstance(key, str) else "y"] = value
        if rng.random() < 0.5:
            holder[f"{key}_"] = holder.pop(key)
    else:
        holder.insert(key, value)
