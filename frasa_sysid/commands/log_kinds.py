"""Options that mean something on one kind of log only: those of a bench and those of the whole robot.

They are told apart where they are added, with what the other kind of log takes in their place; on logs of the other
kind an option that was given is refused, not ignored.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

from frasa_sysid.errors import UsageError
from frasa_sysid.recording import Recording
from frasa_sysid.robot_rig import is_robot

Kind = Literal["bench", "robot"]
TITLES: dict[Kind, str] = {"bench": "logs of a bench", "robot": "logs of the whole robot"}
OTHER: dict[Kind, Kind] = {"bench": "robot", "robot": "bench"}
SHORT: dict[Kind, str] = {"bench": "a bench", "robot": "a whole robot"}


@dataclass(frozen=True)
class OneKind:
    """An option of one kind of log.

    Attributes:
        kind: of the logs that it is for.
        action: the option itself, with its default.
        instead: what logs of the other kind take in its place, such as `--hold-out RULE`; or why they take nothing.
    """

    kind: Kind
    action: argparse.Action
    instead: str

    def given(self, args: argparse.Namespace) -> bool:
        """Whether a command line has it, with another value than it has by itself."""
        return bool(getattr(args, self.action.dest) != self.action.default)

    def refusal(self) -> str:
        """Which option is for which logs, and what the others take."""
        name = self.action.option_strings[0]
        other = SHORT[OTHER[self.kind]]
        return f"{name} is for logs of {SHORT[self.kind]}; {other} {self.instead}"


class KindGroup:
    """Options of a command that are for one kind of log, shown together in its help."""

    def __init__(self, parser: argparse.ArgumentParser, kind: Kind) -> None:
        """Begin a group, empty so far."""
        self._parser, self._kind = parser, kind
        self._group = parser.add_argument_group(TITLES[kind])
        if parser.get_default("one_kind") is None:
            parser.set_defaults(one_kind=[])

    def add(self, *names: str, instead: str, **options: Any) -> None:  # noqa: ANN401 (whatever argparse takes)
        """Add an option as `ArgumentParser.add_argument` does.

        Args:
            names: of the option.
            instead: what the other kind of log does about it, which goes on from "a bench ..." or "a whole robot ...".
            options: as `add_argument` takes them.
        """
        action = self._group.add_argument(*names, **options)
        self._parser.get_default("one_kind").append(OneKind(self._kind, action, instead))


def refuse_other_kind(args: argparse.Namespace, recordings: Sequence[Recording]) -> None:
    """Refuse an option that these logs would ignore; logs of both kinds together are refused elsewhere.

    Raises:
        UsageError: there is one.
    """
    kinds: set[Kind] = {"robot" if is_robot(one) else "bench" for one in recordings}
    if len(kinds) != 1:
        return
    for one in args.one_kind:
        if one.kind not in kinds and one.given(args):
            raise UsageError(one.refusal())
