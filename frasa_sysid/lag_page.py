"""The page of `frasa-sysid lag`: one table by log, one by joint, one by frequency."""

import math
from collections.abc import Sequence

from frasa_sysid.calibration.page import Html, page, section, table, tag
from frasa_sysid.lag import Lag
from frasa_sysid.lag_joint import Joint

_GOOD = ("identified",)
_FAIR = ("known roughly", "periodic")


def lag_page(title: str, found: Sequence[Lag], joints: Sequence[Joint]) -> str:
    """The whole page.

    Args:
        title: which channel against which.
        found: the delay in each log.
        joints: the answer of all logs, by joint.
    """
    parts = [
        tag("p", "Delays in ms with 95 % intervals; ratio: amplitude of the late channel over the other."),
        section("All logs together", _joints(joints)),
        section("By log", _logs(found)),
        section("By frequency", _frequencies(found)),
    ]
    return page(f"Delay of {title}", parts)


def _joints(joints: Sequence[Joint]) -> Html:
    rows = [
        (
            one.joint or "-",
            _ms(one.delay),
            _interval(one.low, one.high),
            f"{one.used} of {one.logs}",
            _pill(one.verdict),
            one.reason,
        )
        for one in joints
    ]
    return table(("joint", "delay", "95 %", "logs", "verdict", "why"), rows, numeric=(1, 2, 3))


def _logs(found: Sequence[Lag]) -> Html:
    rows = [
        (
            one.recording,
            one.joint or "-",
            _ms(one.delay),
            _interval(one.low, one.high),
            _plain(one.ratio),
            f"{one.frequency:.2f}",
            _pill(one.verdict),
            one.reason,
        )
        for one in found
    ]
    heads = ("log", "joint", "delay", "95 %", "ratio", "main Hz", "verdict", "why")
    return table(heads, rows, numeric=(2, 3, 4, 5), css="sort")


def _frequencies(found: Sequence[Lag]) -> Html:
    rows = [
        (
            one.recording,
            one.joint or "-",
            f"{band.frequency:.2f}",
            _ms(band.delay),
            _ms(1.96 * band.error),
            _plain(band.ratio),
        )
        for one in found
        for band in one.bands
    ]
    heads = ("log", "joint", "Hz", "delay", "± 95 %", "ratio")
    return table(heads, rows, numeric=(2, 3, 4, 5), css="sort") if rows else Html()


def _pill(verdict: str) -> Html:
    kind = "good" if verdict in _GOOD else "" if verdict in _FAIR else "bad"
    return tag("span", verdict, css=f"pill {kind}".strip())


def _ms(seconds: float | None) -> str:
    return "-" if seconds is None or math.isnan(seconds) else f"{1e3 * seconds:.2f}"


def _interval(low: float, high: float) -> str:
    return "-" if math.isnan(low) else f"{1e3 * low:.2f} to {1e3 * high:.2f}"


def _plain(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.3f}"
