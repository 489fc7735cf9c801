"""The one way that YAML is read: plain data, each key once, nothing by reference, no more than a person would write.

Ten lines of aliases can stand for more than fits into memory, a tag can name Python, and of a key that stands twice
YAML silently takes the last. None of that is needed in a task, a run, keyframes or ranges.
"""

from collections.abc import Hashable
from pathlib import Path
from typing import Any

import yaml

from frasa_sysid.calibration.bounded_read import read_limited
from frasa_sysid.calibration.errors import InputError

LARGEST = 2**20  # [bytes]; the ranges of a whole robot are 16 kB
DEEPEST = 40  # mappings and lists in each other
LONGEST_NUMBER = 1000  # characters of a whole number; Python itself does not write out more than 4300
# The parser that is compiled is thirty times as fast; it comes with most builds of PyYAML.
_Base: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_STARTS = (yaml.MappingStartEvent, yaml.SequenceStartEvent)
_ENDS = (yaml.MappingEndEvent, yaml.SequenceEndEvent)
# PyYAML makes numbers and dates of texts that only look like some.
_BROKEN = (yaml.YAMLError, ValueError, TypeError, IndexError, KeyError, AttributeError, OverflowError, RecursionError)


def read_yaml(path: Path, error: type[InputError]) -> object:
    """The content of a YAML file.

    Args:
        path: the file.
        error: what is raised where it cannot be used.

    Raises:
        FileNotFoundError: there is none; who asks knows what to do about that.
        InputError: of the kind asked for: no plain file, too large, or not plain YAML.
    """
    content = read_limited(path, LARGEST, error)
    try:
        return parse_yaml(content)
    except ValueError as found:
        raise error(f"{path} is not YAML: {found}") from found


def parse_yaml(content: bytes) -> object:
    """Plain data from YAML.

    Raises:
        ValueError: not YAML, or more than plain data; in one line.
    """
    try:
        text = content.decode("utf-8")
        _check_events(text)
        return yaml.load(text, _Loader)  # a safe loader
    except _BROKEN as error:
        raise ValueError(" ".join(str(error).split())[:300] or type(error).__name__) from error


def _check_events(text: str) -> None:
    """See before anything is made of it that it neither refers to itself nor nests deeply."""
    depth = 0
    for event in yaml.parse(text, _Base):
        if isinstance(event, yaml.AliasEvent):
            raise yaml.YAMLError(f"it holds an alias (*{event.anchor}): write the value out")
        depth += isinstance(event, _STARTS) - isinstance(event, _ENDS)
        if depth > DEEPEST:
            raise yaml.YAMLError(f"more than {DEEPEST} levels of lists and mappings")


class _Loader(_Base):  # type: ignore[misc]  # one of two classes
    """Plain data only."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        if not isinstance(node, yaml.MappingNode):
            raise yaml.YAMLError("expected a mapping")
        seen: set[Hashable] = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if not isinstance(key, Hashable) or key in seen:
                raise yaml.constructor.ConstructorError(None, None, f"key {key!r} stands twice", node.start_mark)
            seen.add(key)
        found: dict[Hashable, Any] = super().construct_mapping(node, deep)
        return found

    def construct_yaml_int(self, node: yaml.ScalarNode) -> int:
        if len(node.value) > LONGEST_NUMBER:
            raise yaml.YAMLError(f"a number of {len(node.value)} digits")
        number: int = super().construct_yaml_int(node)
        return number


_Loader.add_constructor("tag:yaml.org,2002:int", _Loader.construct_yaml_int)
