"""How every command of frasa ends: one line for an error, one JSON object for a machine, an exit status.

Both command lines use it, so that exit 0 means done, 1 failed while running, 2 usage,
3 bad log or model, 4 a quality gate failed, 130 interrupted with the best so far saved.
"""

import argparse
import codecs
import json
import math
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from frasa_sysid.calibration.errors import FrasaError
from frasa_sysid.calibration.provenance import versions

Run = Callable[[argparse.Namespace], dict[str, Any]]


def run_command(parser: argparse.ArgumentParser, arguments: Sequence[str] | None = None) -> int:
    """Parse, run the chosen command, print its JSON when asked, and return the exit status.

    Every subcommand sets `run` (a function of the parsed arguments that returns the
    object for `--json`) with `set_defaults`. Text for people goes to standard error.

    Args:
        parser: the whole command line.
        arguments: words after the program's name; by default those of this process.
    """
    if arguments is None:
        _with_utf8_names()
    odd = next((word for word in (sys.argv[1:] if arguments is None else arguments) if not _is_text(word)), None)
    if odd is not None:
        say(f"{parser.prog}: {odd!a} is not UTF-8: rename the file or folder")
        return 2
    args = parser.parse_args(arguments)
    run: Run = args.run
    try:
        result = run(args)
    except FrasaError as error:
        say(f"{parser.prog}: {error}")
        return error.exit_code
    except KeyboardInterrupt:
        say(f"{parser.prog}: interrupted")
        return 130
    except BrokenPipeError:
        return 1
    except UnicodeEncodeError as error:
        if _is_text(str(error.object)):
            raise
        # A file in a folder that was given: models, pages and logs hold names as UTF-8, and this one is none.
        say(f"{parser.prog}: the name of a file or folder is not UTF-8: rename {ascii(error.object)[:200]}")
        return 3
    except OSError as error:
        place = error.filename if error.filename is not None else "a file"
        say(f"{parser.prog}: cannot use {place}: {error.strerror or error}")
        return 1
    if getattr(args, "json", False):
        said = {**result, "versions": result.get("versions") or versions()}
        print(json.dumps(plain(said), indent=2, allow_nan=False))
    return 0


def _with_utf8_names() -> None:
    """Start over in UTF-8 mode where file names are taken for ASCII (LC_ALL=C with PYTHONUTF8=0).

    Python would hand out names that MuJoCo, XML, JSON and MCAP cannot hold.
    """
    if codecs.lookup(sys.getfilesystemencoding()).name == "ascii" and sys.orig_argv:
        environment = {**os.environ, "PYTHONUTF8": "1"}
        os.execve(sys.executable, [sys.executable, "-X", "utf8", *sys.orig_argv[1:]], environment)


def _is_text(word: str) -> bool:
    """Whether a word of the command line is text, not bytes that no encoding explains."""
    return not any("\ud800" <= letter <= "\udfff" for letter in word)


def say(text: str) -> None:
    """Print text for people, on standard error."""
    print(text, file=sys.stderr, flush=True)


def add_json_flag(parser: argparse.ArgumentParser) -> None:
    """Give a subcommand `--json`."""
    parser.add_argument("--json", action="store_true", help="print one JSON object on standard output")


def add_report_arguments(parser: argparse.ArgumentParser, usual: Path | str) -> None:
    """Give a subcommand `--report` and `--no-report`.

    Args:
        parser: of the subcommand.
        usual: where the page goes when nobody says.
    """
    parser.add_argument("--report", type=Path, metavar="HTML", help=f"name of the HTML page [{usual}]")
    parser.add_argument("--no-report", action="store_true", help="leave out the HTML page")


def tell_report(path: Path | None) -> None:
    """Say where the page is, if there is one."""
    if path is not None:
        say(f"report: {path}")


def plain(value: Any) -> Any:  # noqa: ANN401 - whatever a command returns
    """Plain data for JSON: paths as text, arrays as lists, numbers that are not finite as null."""
    if isinstance(value, dict):
        return {str(key): plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [plain(one) for one in value]
    if isinstance(value, Path):
        return str(value)
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
