"""Which joints and axes of a robot a page shows, as pictures."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from frasa_sysid.calibration.figures import image
from frasa_sysid.calibration.page import Html, join, tag
from frasa_sysid.report_robot_figures import Panel, panel_figure, residual_figure
from frasa_sysid.robot_errors import Compared, Series, errors_by_channel, series

Found = Mapping[str, Sequence[Compared]]
_PANELS = 8  # of joints; all of them are in the picture of residuals
_TRUNK = {  # channel and axis: label, unit, unit of the residual, factor
    ("orientation", "pitch"): ("pitch", "rad", "mrad", 1e3),
    ("orientation", "roll"): ("roll", "rad", "mrad", 1e3),
    ("gyro", "y"): ("rate about y", "rad/s", "rad/s", 1.0),
    ("gyro", "x"): ("rate about x", "rad/s", "rad/s", 1.0),
}
_PIECES = (
    "A log is simulated in pieces of one or two seconds, each begun at the measured state a quarter of a second or "
    "more before it counts: lines break there. Shown are the worst joints and typical ones of each log, each where "
    "it is worst; error panels are scaled to the better robot, and others may leave them."
)


def joint_traces(found: Found, held_from: Mapping[str, float]) -> Html:
    """The worst joints of each log and those in the middle, simulated over measured.

    Args:
        found: by robot; the last one decides which joints are worst.
        held_from: by log, when the part begins that was held out [s].
    """
    logs = logs_of(found)
    each = max(_PANELS // max(len(logs), 1), 2)
    panels = [panel for log in logs[: _PANELS // 2] for panel in _joints_of(found, log, each, held_from.get(log))]
    if not panels:
        return Html()
    words = tag("p", tag("small", _PIECES))
    return join([words, image(panel_figure(panels), "simulated over measured joint angles, with errors below")])


def trunk_traces(found: Found, held_from: Mapping[str, float]) -> Html:
    """Tilt and rates of the trunk on the ground, simulated over measured; nothing where it was held."""
    panels = [panel for log in logs_of(found) for panel in trunk_panels(found, log, held_from.get(log))]
    if not panels:
        return Html()
    return image(panel_figure(panels[:_PANELS]), "simulated over measured tilt and rates of the trunk")


def residual_sizes(found: Found) -> Html:
    """Mean position error of every joint and robot, the worst of the last robot first."""
    errors = {name: errors_by_channel(one)["position"].by_joint for name, one in found.items()}
    last = list(errors.values())[-1]
    order = sorted(last, key=lambda joint: -last[joint])
    ordered = {name: {joint: one.get(joint, 0.0) for joint in order} for name, one in errors.items()}
    return image(residual_figure(ordered), "size of the residuals of every joint")


def logs_of(found: Found) -> list[str]:
    """Names of the logs, in order."""
    return list(dict.fromkeys(name for two in found.values() for one in two for name in one.samples.names))


def _joints_of(found: Found, log: str, count: int, held_from: float | None) -> list[Panel]:
    last = list(found.values())[-1]
    mine = [one for one in last if log in one.samples.names]
    errors = errors_by_channel(mine)["position"].by_joint
    order = sorted(errors, key=lambda joint: -errors[joint])
    worst = order[: (count + 1) // 2]
    middle = max(len(order) // 2 - (count // 2) // 2, len(worst))
    picked = {**dict.fromkeys(worst, "worst"), **dict.fromkeys(order[middle : middle + count // 2], "typical")}
    panels = joint_panels(found, log, list(picked), held_from)
    return [replace(one, title=f"{log}: {joint}, {kind}: {_mean_error(one.series):.1f} mrad")
            for one, (joint, kind) in zip(panels, picked.items(), strict=True)]  # fmt: skip


def joint_panels(found: Found, log: str, joints: Sequence[str], held_from: float | None = None) -> list[Panel]:
    """Some joints of a log, simulated over measured, for `report_robot_figures.panel_figure`.

    Args:
        found: by robot.
        log: its name.
        joints: that were compared.
        held_from: when the part begins that was held out [s].
    """
    panels = []
    for joint in joints:
        lines = {name: one for name, two in found.items() if (one := series(two, log, "position", joint)) is not None}
        panels.append(Panel(f"{joint}: {_mean_error(lines):.1f} mrad", "angle", "rad", "mrad", 1e3, lines, held_from))
    return panels


def trunk_panels(found: Found, log: str, held_from: float | None = None) -> list[Panel]:
    """Tilt and rates of the trunk in a log, simulated over measured; none where the trunk was held."""
    panels = []
    for (channel, axis), (label, unit, small, scale) in _TRUNK.items():
        lines = {name: one for name, two in found.items() if (one := series(two, log, channel, axis)) is not None}
        if lines:
            panels.append(Panel(f"{log}: {label}", label, unit, small, scale, lines, held_from))
    return panels


def _mean_error(lines: Mapping[str, Series]) -> float:
    last = list(lines.values())[-1]
    return float(abs(last.residuals).mean()) * 1e3
