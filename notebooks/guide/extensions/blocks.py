"""What a page asks its reader to run: commands, Python and maps, in their order, with how the tests run them.

Commands stand in fenced blocks `bash` (all lines) and `console` (lines after `$ `, the rest is what they print), and
in indented blocks that begin with one of our programs. How a test runs the commands of the next block, where that is
not just so, is said in a comment in front of it, a line each, by the words that the commands begin with:

    <!-- run
    frasa-rl train: --minutes 0.1        these options instead of its own, or beside them
    frasa-sysid fit bad.mcap: exit 3     it ends with this status
    make demo: parsed only, because ...  it is not run, its arguments are looked at
    before: cp a.mcap b.mcap             run in front of the block
    -->

A fenced block of `python` is run, one of `toml` is read as a map of signals, and kept under the name in its first line.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

PROGRAMS = ("frasa-sysid", "frasa-rl", "make", "pip", "python", "dask")
_FENCE = re.compile(r"^(`{3,}|:{3,})\s*([^\s`]*)[^`]*$")


@dataclass(frozen=True)
class Command:
    """One line of a shell.

    Attributes:
        text: as it stands in the page, continuation lines joined, without a comment behind it.
        shown: lines that the page says it prints.
        options: to replace or to add in a test.
        status: that it ends with.
        unrun: why a test only looks at its arguments; empty where it is run.
        before: commands that a test runs first.
    """

    text: str
    shown: tuple[str, ...] = ()
    options: str = ""
    status: int = 0
    unrun: str = ""
    before: tuple[str, ...] = ()


@dataclass(frozen=True)
class Block:
    """A block of a page.

    Attributes:
        line: where it begins in its file.
        language: `shell`, `python` or `toml`.
        text: of it.
        commands: of a shell.
    """

    line: int
    language: str
    text: str
    commands: tuple[Command, ...] = field(default=())


def blocks(page: Path) -> list[Block]:
    """The blocks of a page that can be run, in order.

    Raises:
        ValueError: a rule that is of no command of its block.
    """
    found = []
    text = page.read_text(encoding="utf-8")
    for line, language, lines, rules in _raw(text):
        if language in ("bash", "console", "indented"):
            commands = list(_commands(lines, console=language == "console"))
            commands = _ruled(commands, rules, f"{page.name}:{line}")
            found.append(Block(line, "shell", "\n".join(lines), tuple(commands)))
        elif language in ("python", "toml"):
            found.append(Block(line, language, "\n".join(lines) + "\n"))
    return found


def _raw(text: str) -> Iterator[tuple[int, str, list[str], list[str]]]:
    """Line number, language, lines and rules of each block."""
    rules: list[str] = []
    lines = text.split("\n")
    place = 0
    while place < len(lines):
        start, line = place, lines[place]
        place += 1
        if line == "<!-- run":
            end = lines.index("-->", place)
            rules, place = [one.strip() for one in lines[place:end] if one.strip()], end + 1
        elif fence := _FENCE.match(line):
            if fence[1].startswith(":"):
                continue  # a note: what is in it counts
            place = lines.index(fence[1], place) + 1
            yield start + 1, fence[2], lines[start + 1 : place - 1], rules
            rules = []
        elif line.startswith("    ") and line.split()[0] in PROGRAMS and not lines[start - 1].strip():
            while place < len(lines) and (lines[place].startswith("    ") or not lines[place].strip()):
                place += 1
            yield start + 1, "indented", [one[4:] for one in lines[start:place]], rules
            rules = []


def _commands(lines: list[str], *, console: bool) -> Iterator[Command]:
    text, shown = "", list[str]()
    for line in lines:
        if console and not text.endswith("\\") and not line.startswith("$ "):
            shown.append(line)
            continue
        if text and not text.endswith("\\"):
            yield Command(text, tuple(shown))
            text, shown = "", []
        part = line.removeprefix("$ ") if console else line
        part = re.sub(r"\s+#\s.*$", "", part).rstrip()
        if part.lstrip().startswith("#"):
            continue
        text = text.removesuffix("\\") + (" " + part.strip() if text else part)
    if text:
        yield Command(text, tuple(shown))


def _ruled(commands: list[Command], rules: list[str], where: str) -> list[Command]:
    changed = list(commands)
    for rule in rules:
        start, _, rest = (one.strip() for one in rule.partition(": "))
        if start == "before":
            first = changed[0]
            changed[0] = _with(first, before=(*first.before, rest))
            continue
        hits = [i for i, one in enumerate(changed) if one.text.startswith(start)]
        if not hits:
            raise ValueError(f"{where}: no command here begins with '{start}'")
        for i in hits:
            changed[i] = _with(changed[i], **_meaning(rest, where))
    return changed


def _meaning(rest: str, where: str) -> dict[str, object]:
    if status := re.fullmatch(r"exit (\d+)", rest):
        return {"status": int(status[1])}
    if rest.startswith("parsed only, "):
        return {"unrun": rest.removeprefix("parsed only, ")}
    if rest.startswith("-"):
        return {"options": rest}
    raise ValueError(f"{where}: '{rest}': expected options, 'exit N' or 'parsed only, because ...'")


def _with(command: Command, **changes: object) -> Command:
    return Command(**{**vars(command), **changes})  # type: ignore[arg-type]
