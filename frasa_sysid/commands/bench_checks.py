"""What a fit of a bench does about logs that look wrong: it refuses a wrong sign and the like, tells of the rest."""

from collections import defaultdict
from collections.abc import Sequence

from rich.console import Console

from frasa_sysid.commands.log_health import all_checks
from frasa_sysid.errors import LogError
from frasa_sysid.joint_checks import Check
from frasa_sysid.recording import Recording

# A servo too weak or too slow for its goal is far from it on average, as a shifted encoder would be; all of the runs
# together tell them apart, and a fit has the zero as a number.
SAID_ONLY = ("wrong_zero",)
# The fit says it itself, with the signals that there are.
LEFT_TO_THE_FIT = ("no_goal", "no_joints", "no_positions", "too_short")


def check_bench(console: Console, recordings: Sequence[Recording]) -> None:
    """Look at all runs of a bench before they are fitted, and print what is doubtful, a line for each kind.

    Raises:
        LogError: a fit would be misled.
    """
    found = [one for one in all_checks(recordings) if one.code not in LEFT_TO_THE_FIT]
    refused = [one for one in found if one.level == "refuse" and one.code not in SAID_ONLY]
    if refused:
        first = refused[0]
        alike = len({one.recording for one in refused if one.code == first.code})
        more = f" ({alike} of {len(recordings)} runs alike)" if alike > 1 else ""
        raise LogError(f"{first.recording} would mislead a fit: {first.message}{more}; frasa-sysid inspect shows all")
    by_code: dict[str, list[Check]] = defaultdict(list)
    for one in found:
        by_code[one.code].append(one)
    for code, several in by_code.items():
        runs = len({one.recording for one in several})
        where = f"{runs} of {len(recordings)} runs, such as " if runs > 1 else ""
        first = several[0]
        console.print(f"{code}: {where}{first.recording}: {first.message}", markup=False, soft_wrap=True)
