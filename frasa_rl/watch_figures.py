"""Trials as figures: strips of pictures, or of stick figures where a machine draws no pictures; traces over time."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from frasa_rl.film import Shots, evenly, film_of
from frasa_rl.render import RenderError
from frasa_rl.robot import Floats
from frasa_rl.simulation import set_state
from frasa_rl.watch import Watched
from frasa_sysid.calibration.figures import BLUE, GREEN, GREY, INK, ORANGE, PURPLE, RED, SKY

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = (BLUE, RED, GREEN, ORANGE, PURPLE, SKY, GREY)
_SHOTS = Shots(count=8, width=220, height=260)
_FLOOR, _TOP = -0.03, 0.75  # of a stick figure's panel [m]
_HALF = 0.42  # half of its width [m]


def strip_figure(
    watched: Watched, title: str = "", count: int = 8, sticks: bool = False, push: bool = False
) -> "Figure":
    """Moments of a trial beside each other.

    Args:
        watched: the trial, with textures for pictures.
        title: over all of them.
        count: moments, evenly spaced, the first and the last among them.
        sticks: draw stick figures even where pictures can be drawn.
        push: seen from further away, straight from the side, so that the pendulum shows.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 11 / count * 1.18 + 0.35), layout="constrained")
    axes = list(np.ravel(figure.subplots(1, count)))
    moments = evenly(len(watched.t), count)
    if sticks or not _draw_pictures(axes, watched, count, push):
        _draw_sticks(axes, watched, moments)
    for ax, index in zip(axes, moments, strict=False):
        ax.set_title(f"{watched.t[index]:.2f} s", loc="center", fontsize=8)
        ax.set(xticks=[], yticks=[])
        ax.grid(visible=False)
        ax.spines[:].set_visible(False)
    figure.suptitle(title, x=0.01, ha="left")
    return figure


def _draw_pictures(axes: "Sequence[Axes]", watched: Watched, count: int, push: bool) -> bool:
    """Pictures into the axes, where this machine can draw any."""
    view = {"distance": 1.9, "azimuth": 90.0} if push else {}
    try:
        film = film_of(watched, Shots(count, _SHOTS.width, _SHOTS.height), **view)
    except RenderError:
        return False
    for ax, frame in zip(axes, film.frames, strict=False):
        ax.imshow(frame)
    return True


def _draw_sticks(axes: "Sequence[Axes]", watched: Watched, moments: Sequence[int]) -> None:
    """The robot from its right, as lines between its joints; its left side is drawn behind."""
    model, data = watched.model, mujoco.MjData(watched.model)
    set_state(model, data, watched.states[-1])
    trunk = model.body(watched.trunk).id
    forward = data.xmat[trunk].reshape(3, 3)[:2, 0]
    forward = forward / max(float(np.linalg.norm(forward)), 1e-9)
    for ax, index in zip(axes, moments, strict=False):
        set_state(model, data, watched.states[index])
        middle = float(data.xpos[trunk, :2] @ forward)
        for body, parent in _limbs(model, trunk):
            places = [data.xpos[parent], data.xpos[body], *_tips(model, data, body)]
            line = np.array([(one[:2] @ forward - middle, one[2]) for one in places])
            ax.plot(line[:, 0], line[:, 1], color=_shade(model.body(body).name), lw=2.6, solid_capstyle="round")
        _draw_others(ax, model, data, trunk, forward, middle)
        ax.axhline(0.0, color=GREY, lw=1.0)
        ax.set(xlim=(-_HALF, _HALF), ylim=(_FLOOR, _TOP), aspect="equal")


def _limbs(model: mujoco.MjModel, trunk: int) -> list[tuple[int, int]]:
    """Bodies of the robot and the one each hangs on, the left side first."""
    robot = [body for body in range(1, model.nbody) if model.body_rootid[body] == model.body_rootid[trunk]]
    pairs = [(body, int(model.body_parentid[body])) for body in robot if body != trunk and model.body_parentid[body]]
    return sorted(pairs, key=lambda pair: "left" not in model.body(pair[0]).name)


def _tips(model: mujoco.MjModel, data: mujoco.MjData, body: int) -> list[Floats]:
    """The shape that reaches furthest from the frame of a body nothing hangs on: a hand; none for others [m]."""
    geoms = [one for one in range(model.ngeom) if model.geom_bodyid[one] == body and _touches(model, one)]
    if not geoms or (model.body_parentid == body).any():
        return []
    away = np.linalg.norm(data.geom_xpos[geoms] - data.xpos[body], axis=1)
    return [data.geom_xpos[geoms[int(np.argmax(away))]]]


def _touches(model: mujoco.MjModel, geom: int) -> bool:
    return bool(model.geom_contype[geom] | model.geom_conaffinity[geom])


def _shade(name: str) -> str:
    return SKY if "left" in name else BLUE if "right" in name else INK


def _draw_others(
    ax: "Axes", model: mujoco.MjModel, data: mujoco.MjData, trunk: int, forward: Floats, middle: float
) -> None:
    """Collision shapes as dots, so that feet and trunk have an extent, and whatever else moves: the pendulum's bob."""
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        if body == 0 or not _touches(model, geom):
            continue
        own = model.body_rootid[body] == model.body_rootid[trunk]
        x, z = float(data.geom_xpos[geom, :2] @ forward) - middle, float(data.geom_xpos[geom, 2])
        if abs(x) < _HALF:
            ax.plot(x, z, "o", ms=2.2 if own else 9.0, color=GREY if own else RED, zorder=1 if own else 3)


def watched_figure(cases: Mapping[str, Watched]) -> "Figure":
    """Trunk and joints of trials over time: what was measured full, what was commanded dotted; how far from standing.

    Args:
        cases: by name, all of one task.
    """
    from matplotlib.figure import Figure

    first = next(iter(cases.values()))
    names = ("trunk pitch, deg", "trunk height, m", "largest error, deg", *(f"{one}, deg" for one in first.names))
    rows = -(-len(names) // 2)
    figure = Figure(figsize=(11, 1.55 * rows + 0.3), layout="constrained")
    axes = np.ravel(figure.subplots(rows, 2, sharex=True))
    for (name, one), colour in zip(cases.items(), COLOURS, strict=False):
        trunk = (np.degrees(one.pitch), one.height, one.worst_deg)
        for ax, y in zip(axes, (*trunk, *np.degrees(one.joints).T), strict=False):
            ax.plot(one.t, y, color=colour, lw=1.4, label=name)
        for ax, y in zip(axes[len(trunk) :], np.degrees(one.commands).T, strict=False):
            ax.plot(one.t, y, color=colour, lw=1.0, ls=":")
    for ax, name in zip(axes, names, strict=False):
        ax.set_ylabel(name)
    for ax in axes[len(names) :]:
        ax.set_visible(False)
    for ax in axes[-2:]:
        ax.set_xlabel("time, s")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper left", ncols=6, frameon=False)
    return figure


def action_figure(watched: Watched) -> "Figure":
    """Every decision: a row for each joint, a column for each control period; blue turns one way, red the other."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 0.34 * len(watched.names) + 0.9), layout="constrained")
    ax = figure.subplots()
    period = float(watched.t[1] - watched.t[0])
    extent = (0.0, float(watched.t[-1]), len(watched.names) - 0.5, -0.5)
    picture = ax.imshow(
        watched.actions[1:].T, aspect="auto", cmap="RdBu_r", vmin=-1, vmax=1, extent=extent, interpolation="nearest"
    )
    ax.set_yticks(range(len(watched.names)), watched.names)
    ax.set_xlabel(f"time, s (a decision every {1e3 * period:.0f} ms)")
    ax.grid(visible=False)
    figure.colorbar(picture, ax=ax, label="share of the\nrate limit")
    return figure
