"""The directive `command-line`: every command, argument and option of an argparse parser, as the parser has them now.

```{command-line} frasa_sysid.cli:build_parser
```
"""

import argparse
from collections.abc import Iterator
from functools import partial
from importlib import import_module

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

WIDTH = 96


class CommandLine(SphinxDirective):
    """A section for each command of a program."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """The sections."""
        module, _, maker = self.arguments[0].partition(":")
        parser = getattr(import_module(module), maker)()
        said = [nodes.paragraph(text=parser.description or "")]
        if parser.epilog:
            said.append(nodes.paragraph(text=parser.epilog))
        return [*said, *(_section(name, one, brief) for name, one, brief in commands(parser))]


def commands(parser: argparse.ArgumentParser) -> Iterator[tuple[str, argparse.ArgumentParser, str]]:
    """Name, parser and one line of help for each command of a program."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            briefs = {one.dest: one.help or "" for one in action._choices_actions}
            for name, one in action.choices.items():
                yield name, one, briefs.get(name, "")


def _section(name: str, parser: argparse.ArgumentParser, brief: str) -> nodes.section:
    section = nodes.section(ids=[nodes.make_id(parser.prog)], names=[parser.prog])
    section += nodes.title(text=parser.prog)
    section += nodes.paragraph(text=parser.description or _sentence(brief))
    parser.formatter_class = partial(argparse.HelpFormatter, width=WIDTH)
    section += nodes.literal_block(text=parser.format_usage().strip(), language="none")
    for group in parser._action_groups:
        actions = [one for one in group._group_actions if one.help != argparse.SUPPRESS and one.dest != "help"]
        if actions:
            section += _group(group, actions)
    return section


def _group(group: argparse._ArgumentGroup, actions: list[argparse.Action]) -> list[nodes.Node]:
    title = group.title or ""
    heading = [] if title in ("positional arguments", "options") else [nodes.rubric(text=_sentence(title).rstrip("."))]
    items = nodes.definition_list(classes=["options"])
    for one in actions:
        term = nodes.term("", "", nodes.literal(text=_spelling(one)))
        items += nodes.definition_list_item("", term, nodes.definition("", nodes.paragraph(text=_sentence(_help(one)))))
    return [*heading, items]


def _spelling(action: argparse.Action) -> str:
    """How an argument is written."""
    choices = "{" + ", ".join(map(str, action.choices)) + "}" if action.choices else ""
    metavar = action.metavar if isinstance(action.metavar, str) else choices or action.dest.upper()
    if not action.option_strings:
        return metavar + (" ..." if action.nargs == "+" else "")
    if action.nargs == 0:
        return ", ".join(action.option_strings)
    more = f" [{metavar} ...]" if action.nargs == "+" else ""
    return f"{', '.join(action.option_strings)} {f'[{metavar}]' if action.nargs == '?' else metavar}{more}"


def _help(action: argparse.Action) -> str:
    """An argument's help with its own default in it."""
    values = {name: value for name, value in vars(action).items() if name != "help"}
    return (action.help or "no words yet") % values


def _sentence(text: str) -> str:
    text = text.strip()
    return text[:1].upper() + text[1:] + ("" if text.endswith((".", ")", "]", "!")) or not text else ".")


def setup(app: Sphinx) -> dict[str, bool]:
    """Register with Sphinx."""
    app.add_directive("command-line", CommandLine)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
