"""Pictures of a servo on the bench."""

import io
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from frasa_sysid.bench_session import BenchSession
from frasa_sysid.calibration import SERVO_FIELDS, load_model, read
from frasa_sysid.calibration.figures import BLUE, GREY, INK, ORANGE, RED, SKY, look
from frasa_sysid.problem import stated_servo
from frasa_sysid.readers import read_log
from frasa_sysid.rig import BenchRun, runs_of
from frasa_sysid.servo import NOMINAL, PUBLISHED_M4
from frasa_sysid.servo_values import ServoValues
from frasa_sysid.stored_fit import load as load_fit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SERVO = "mx106"


def svg(picture: "Callable[[Path], Figure]", root: Path) -> bytes:
    """A picture in the look of all of them; the same one gives the same bytes."""
    with look():
        buffer = io.BytesIO()
        picture(root).savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return buffer.getvalue()


def _runs(root: Path, session: BenchSession, wanted: dict[str, object]) -> list[BenchRun]:
    recordings = [
        one
        for one in read_log(root / "bench_logs" / f"{SERVO}.mcap")
        if all(getattr(one.rig, name) == value for name, value in wanted.items())
    ]
    return runs_of(recordings, session.servo, session.options.timestep)


def _session(root: Path) -> tuple[BenchSession, ServoValues]:
    servo, nominal = stated_servo(SERVO, root / "robot_model" / "nominal.xml")
    return BenchSession(root / "robot_model" / "bench_pendulum.xml", servo), ServoValues(**nominal)


def torque_off(root: Path) -> "Figure":
    """Two servos with the same damping while powered: only a drop with the torque off tells them apart."""
    from matplotlib.figure import Figure

    session, nominal = _session(root)
    others = {"K_v = 0.035 N m s/rad": nominal, "K_v = 0.35 N m s/rad": replace(nominal, damping_off=0.35)}
    figure = Figure(figsize=(9.2, 2.9), layout="constrained")
    axes = figure.subplots(1, 2, sharey=True)
    with session:
        for ax, name in zip(axes, ("sin_time_square", "lift_and_drop"), strict=True):
            run = _runs(root, session, {"mass": 1.2, "firmware_gain": 16.0, "trajectory": name})[0]
            table = np.array([one.array() for one in others.values()])
            for (label, _), rows, colour, width in zip(
                others.items(), session.split(session.kernel([run]), table), (BLUE, ORANGE), (3.0, 1.4), strict=True
            ):
                ax.plot(run.t, rows[0], color=colour, lw=width, label=label)
            if run.switches.size:
                ax.axvspan(float(run.switches[0]), float(run.t[-1]), color=GREY, alpha=0.15, lw=0)
                where = ax.get_xaxis_transform()
                ax.text(float(run.switches[0]) + 0.1, 0.03, "torque off", color=INK, transform=where)
            ax.set(title=f"{name}, 1.2 kg at 0.15 m", xlabel="time [s]")
    axes[0].set_ylabel("angle [rad]")
    axes[1].legend(loc="lower right")
    return figure


def friction_laws(root: Path) -> "Figure":
    """What stops an MX-106 that holds a load: its Coulomb-viscous law and its M4 law, over speed and load."""
    from matplotlib.figure import Figure

    del root  # the numbers are published ones
    speed = np.linspace(0.0, 6.0, 400)
    m1, m4 = NOMINAL[SERVO].friction, PUBLISHED_M4[SERVO].friction
    figure = Figure(figsize=(9.2, 2.9), layout="constrained")
    left, right = figure.subplots(1, 2)
    for load, colour in ((0.0, SKY), (2.0, BLUE), (4.0, ORANGE)):
        motor = np.full_like(speed, load)
        left.plot(speed, m4.bound(motor, -motor, speed), color=colour, label=f"M4, {load:.0f} N m held")
    left.plot(speed, m1.bound(0 * speed, 0 * speed, speed), color=RED, ls="--", label="M1, any load")
    left.set(xlabel="joint speed [rad/s]", ylabel="friction bound [N m]", title="over speed", ylim=(0, None))
    left.legend()
    load = np.linspace(0.0, 6.0, 200)
    for slow, colour in ((0.0, BLUE), (0.5, ORANGE), (5.0, SKY)):
        right.plot(load, m4.bound(load, -load, np.full_like(load, slow)), color=colour, label=f"M4 at {slow:g} rad/s")
    right.axhline(m1.coulomb, color=RED, ls="--", label="M1 at rest")
    right.set(xlabel="load held [N m]", title="over load", ylim=(0, None))
    right.legend()
    return figure


def simulated_over_measured(root: Path) -> "Figure":
    """One run of the bench log with what the nominal and the calibrated servo make of it."""
    from matplotlib.figure import Figure

    session, nominal = _session(root)
    model = load_model(root / "robot_model" / "calibrated.xml")
    fit = load_fit(root / "robot_model" / "fits" / f"{SERVO}.json")
    found = {field: read(model, f"{SERVO}.{field}") for field in SERVO_FIELDS}
    law = (
        {name: value for name, value in vars(fit.law).items() if name not in ("viscous", "coulomb")} if fit.law else {}
    )
    fitted = replace(
        nominal,
        **{**found, **law},
        offset=fit.parameters["bench.offset"]["value"],
        damping_off=fit.parameters[f"{SERVO}.damping_off"]["value"],
        **({"sag": fit.parameters["bench.sag"]["value"], "rest": 1.0} if "bench.sag" in fit.parameters else {}),
    )
    figure = Figure(figsize=(9.2, 3.4), layout="constrained")
    axes = figure.subplots(2, 2, sharex=True, height_ratios=(2.4, 1))
    with session:
        for column, name in zip(axes.T, ("sin_sin", "lift_and_drop"), strict=True):
            run = _runs(root, session, {"mass": 2.0, "firmware_gain": 8.0, "trajectory": name})[0]
            rows = session.split(session.kernel([run]), np.array([nominal.array(), fitted.array()]))
            column[0].plot(run.t, run.y, color=INK, alpha=0.35, lw=4, label="measured")
            for (reading,), label, colour in zip(rows, ("nominal", "calibrated"), (RED, BLUE), strict=True):
                column[0].plot(run.t, reading, color=colour, lw=1.3, label=label)
                column[1].plot(run.t, 1e3 * (reading - run.y), color=colour, lw=1.0)
            column[0].set_title(f"{name}, 2 kg at 0.2 m, P = 8")
            column[1].set(xlabel="time [s]", ylim=(-60, 60))
    axes[0, 0].set_ylabel("angle [rad]")
    axes[1, 0].set_ylabel("error [mrad]")
    axes[0, 0].legend()
    return figure
