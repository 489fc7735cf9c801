"""The page of a whole robot's fit, and of a comparison of robots: one HTML file, pictures inside, opens offline."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from frasa_sysid import report_robot_tables as tables
from frasa_sysid.calibration import write_atomic
from frasa_sysid.calibration.figures import has_matplotlib, image, look
from frasa_sysid.calibration.page import Html, join, page, section, table, tag
from frasa_sysid.report_figures import READABLE, correlation_figure
from frasa_sysid.report_robot_traces import joint_traces, residual_sizes, trunk_traces
from frasa_sysid.robot_errors import Compared
from frasa_sysid.robot_fit import RobotFit
from frasa_sysid.robot_fit_record import RobotFitRecord


@dataclass(frozen=True)
class RobotPage:
    """What the page of a robot's fit shows.

    Attributes:
        fit: what was found.
        record: the same as it is saved.
        compared: `before` the fit and `fitted`, over all of the logs.
        servos: whose bench fits were frozen.
        held_from: by log, when the part begins that was held out [s].
        parts: which parts of which logs were fitted, in words; empty where all of them were.
    """

    fit: RobotFit
    record: RobotFitRecord
    compared: Mapping[str, Sequence[Compared]]
    servos: Sequence[str] = ()
    held_from: Mapping[str, float] = field(default_factory=dict)
    parts: str = ""


def write_robot_report(path: Path, one: RobotPage) -> Path | None:
    """Write the page of a fit.

    Args:
        path: HTML file to make.
        one: what to show.

    Returns:
        The file, or None where matplotlib is not installed.
    """
    if not has_matplotlib():
        return None
    with look():
        parts = _parts(one)
    count = len(one.fit.problem.runs)
    write_atomic(path, page(f"Whole robot: fit of {count} log{'s' if count > 1 else ''}", parts))
    return path


def _parts(one: RobotPage) -> list[Html]:
    return [
        tables.summary(one.fit, one.record, one.servos, one.parts),
        section("Numbers", tables.number_table(one.fit, one.record), tables.physical_delays(one.fit)),
        section("What to record next", tables.record_next(one.record)),
        section("Errors by channel", tables.error_table(one.fit)),
        section("Simulated over measured: joints", joint_traces(one.compared, one.held_from)),
        section("Simulated over measured: trunk", trunk_traces(one.compared, one.held_from)),
        section("Residuals by joint", residual_sizes(one.compared)),
        section("How the numbers move together", _correlation(one.fit)),
        section("What this rests on", tables.origins(one.fit, one.record)),
    ]


def write_robot_comparison(
    path: Path, title: str, found: Mapping[str, Sequence[Compared]], inputs: Mapping[str, str]
) -> Path | None:
    """Write a page of errors and traces only; None where matplotlib is not installed.

    Args:
        path: HTML file to make.
        title: of the page.
        found: by robot, the last one decides what is drawn.
        inputs: sha256 by log.
    """
    if not has_matplotlib():
        return None
    with look():
        parts = [
            tables.error_cards(found),
            section("Errors by channel", tables.channels(found)),
            section("Simulated over measured: joints", joint_traces(found, {})),
            section("Simulated over measured: trunk", trunk_traces(found, {})),
            section("Residuals by joint", residual_sizes(found)),
            section("Error of every log", tables.logs(found)),
            section("What this rests on", table(("log", "sha256"), [[a, tag("code", b)] for a, b in inputs.items()])),
        ]
    write_atomic(path, page(title, parts))
    return path


def _correlation(fit: RobotFit) -> Html:
    """The map of all numbers, or of those that are tied most where there are more than can be read."""
    sd = np.sqrt(np.diag(fit.logged))
    correlation = fit.logged / np.outer(sd, sd)
    strongest = np.abs(correlation - np.eye(sd.size)).max(axis=1)
    kept = np.sort(np.argsort(-strongest)[:READABLE])
    names = [fit.problem.free[i].name for i in kept]
    words = "By these logs alone: numbers far from white cannot be told apart from one another."
    if kept.size < sd.size:
        words += f" Shown are the {kept.size} of {sd.size} that are tied most."
    picture = image(correlation_figure(names, correlation[np.ix_(kept, kept)]), "correlation of the estimates")
    return join([tag("p", words), picture])
