"""What is said of a log that is kept in part: which part, why, and what the rest of it is like."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from frasa_sysid.readers.kept_windows import OUTSIDE
from frasa_sysid.readers.mcap_series import Collected
from frasa_sysid.readers.sampling import plural
from frasa_sysid.readers.series import CLOCKS, Series, Tally, tally
from frasa_sysid.recording import Clock, Fault

CHOOSE = "--between FROM TO chooses others"
SHOWN = 4  # stretches that are named


def excerpt_faults(
    collected: Collected, named: Mapping[str, Series], stretches: Sequence[Sequence[int]], clock: Clock
) -> list[Fault]:
    """What a log in part is an excerpt of, and what was wrong with the rest of it; nothing for a whole one.

    Args:
        collected: of the file.
        named: its signals.
        stretches: windows that are kept.
        clock: whose stamps count.
    """
    windows = collected.windows
    if not windows.gone:
        return []
    found = [_excerpt(collected, named, stretches)]
    for name, series in sorted(named.items()):
        rest = [one for window in windows.gone for one in series.tallies.get(window, [])]
        bad, back, again, gaps = (
            sum(one.not_finite for one in rest),
            *(sum(getattr(one, what)[clock] for one in rest) for what in ("backwards", "repeated", "gaps")),
        )
        said = [
            f"{plural(bad, 'sample')} not finite" if bad else "",
            f"time ran backwards {plural(back, 'time')}" if back else "",
            f"{plural(again, 'sample')} with a stamp that was there before" if again else "",
            f"{plural(gaps, 'gap')}, the longest {max((one.longest[clock] for one in rest), default=0) / 1e9:.4g} s"
            if gaps
            else "",
        ]
        if any(said):
            text = f"{name}, in the part that is not kept: {', '.join(filter(None, said))}"
            found.append(Fault("rest_of_log", bad + back + again + gaps, text))
    return found


def nothing_inside(collected: Collected) -> str:
    """Why no recording is left of a file that has messages."""
    asked = collected.windows.limit.between
    if asked is None:
        return "none of its messages lies in the time window of a run"
    return f"nothing between {asked[0]:g} and {asked[1]:g} s; the log goes from 0 to {collected.windows.seconds:.1f} s"


def whole_log(named: Mapping[str, Series], stretches: Sequence[Sequence[int]], clock: Clock) -> dict[str, Any]:
    """Every signal over the whole log, as plain JSON values: samples, seconds, extremes.

    Args:
        named: signals of the file.
        stretches: windows that are kept.
        clock: whose stamps count.
    """
    kept = [window for stretch in stretches for window in stretch]
    place = CLOCKS.index(clock)
    found = {}
    for name, series in named.items():
        parts: list[Tally] = [tally(block) for window in kept for block in series.blocks(window)]
        parts += [one for several in series.tallies.values() for one in several]
        stamps = np.concatenate([one.stamps[:, place] for one in parts]) if parts else np.zeros(0, np.uint64)
        filled = stamps[stamps > 0]
        found[name] = {
            "samples": series.size,
            "seconds": float(filled.max() - filled.min()) / 1e9 if filled.size else 0.0,
            "low": min((one.low for one in parts if np.isfinite(one.low)), default=np.nan),
            "high": max((one.high for one in parts if np.isfinite(one.high)), default=np.nan),
            "not_finite": sum(one.not_finite for one in parts),
            "longest_step_s": max((one.longest[clock] for one in parts), default=0) / 1e9,
        }
    return {"whole_log": found}


def _excerpt(collected: Collected, named: Mapping[str, Series], stretches: Sequence[Sequence[int]]) -> Fault:
    windows = collected.windows
    rows = sum(one.rows for series in named.values() for several in series.tallies.values() for one in several)
    spans = [windows.span(stretch) for stretch in stretches if stretch]
    seconds = sum(end - begin for begin, end in spans)
    parts = ", ".join(f"{begin:.0f}-{end:.0f}" for begin, end in spans[:SHOWN])
    parts += f" and {len(spans) - SHOWN} more" if len(spans) > SHOWN else ""
    if windows.limit.between is not None and windows.gone == {OUTSIDE}:
        text = f"{seconds:.0f} s of {windows.seconds:.0f} are used ({parts} s), as asked"
    else:
        text = (
            f"{windows.seconds:.0f} s are more than memory is given to: the {seconds:.0f} s in which the joints move "
            f"most are used ({parts} s); {CHOOSE}"
        )
    return Fault("excerpt", rows, text)
