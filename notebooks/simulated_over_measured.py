# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]

# %% [markdown]
# # Simulated over measured
#
# The only picture that counts: the log, and what a model makes of the same goals. First one servo on the bench, then
# the whole robot. Nominal is what the data sheet says, calibrated is what was published, fitted is what a fit finds
# here and now.
#
# The logs are simulated with a known truth (`bench_logs/README.md`); the programs that made them are not the ones
# that are fitted. Put your own log in. `frasa-sysid compare LOG --with-model robot_model/calibrated.xml` leaves the
# same as a page.

# %%
import os
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from frasa_sysid import robot_compare
from frasa_sysid.bench import bench_of
from frasa_sysid.bench_compare import compare_bench, of_model, of_nominal, of_result
from frasa_sysid.bench_fit import fit_bench
from frasa_sysid.calibration import load_calibration
from frasa_sysid.calibration.figures import BLUE, GREEN, ORANGE, SKY, wear_look
from frasa_sysid.readers import read_log
from frasa_sysid.report_figures import trace_figure
from frasa_sysid.report_residuals import error_figure, residual_figure
from frasa_sysid.report_robot_figures import panel_figure
from frasa_sysid.report_robot_figures import residual_figure as joint_figure
from frasa_sysid.report_robot_traces import joint_panels, trunk_panels
from frasa_sysid.robot_compare import compare_robot, last_share
from frasa_sysid.robot_errors import errors_by_channel, series
from frasa_sysid.robot_fit import fit_robot
from frasa_sysid.stored_fit import load

os.chdir(next(one for one in (Path.cwd(), *Path.cwd().parents) if (one / "robot_model").is_dir()))
wear_look()

# %% [markdown]
# **What to change.** A log of your own, a model of your own, a friction law (`m1` to `m6`).

# %%
LOG, ROBOT_LOG = Path("bench_logs/mx106.mcap"), Path("bench_logs/robot.mcap")
NOMINAL, CALIBRATED = Path("robot_model/nominal.xml"), Path("robot_model/calibrated.xml")
LAW = "m1"
SHOWN = (13, 14, 24, 35)  # runs that are drawn

# %% [markdown]
# ## One servo
#
# Every run is simulated from its goals and its first moment alone: errors add up, nothing pulls the simulation back.

# %%
bench = bench_of(read_log(LOG))
contenders = [
    of_nominal(bench),
    of_result(f"fitted, {LAW}", fit_bench(bench, LAW, restarts=1)),
    of_model("calibrated", CALIBRATED, bench),
]
compared = compare_bench(contenders, bench)
for name, error in compared.errors.items():
    print(f"{name:>12}: {error.mae_rad * 1e3:5.2f} mrad mean error over {len(compared.runs)} runs")

# %% [markdown]
# Above each run, below what is simulated minus what was measured; grey where the torque is off.
#
# *Look for* the shape of an error. One that follows the angle is a wrong gain or a wrong load. One that follows the
# speed is a delay or damping. Steps at each turn are dry friction. A constant is a zero error. Noise of one count
# (1.5 mrad) is the encoder: nothing is left.

# %%
trace_figure([compared.traces[i] for i in SHOWN])

# %% [markdown]
# All runs at once. Left: how many samples are closer than so many milliradians. Right: whether errors grow along a
# run. *Wrong would be* a calibrated line that crosses the others (good on average, bad in the worst case), or one
# that rises with time (a load that is not what the log says).

# %%
residual_figure(compared.traces)

# %% [markdown]
# Each run for itself, the worst first: is it always the same load, or the same motion?

# %%
by_run = {name: error.by_run for name, error in compared.errors.items()}
error_figure(by_run, sorted(compared.runs, key=lambda run: -by_run["calibrated"][run.name])[:16])

# %% [markdown]
# ## A delay is a shift
#
# The calibrated servo with no delay, with its own, and with one that is too long. *Look at* the flanks, not at the
# peaks: that is where a delay shows, and only there.


# %%
def delayed(contender, delay):
    return replace(contender, name=f"{delay * 1e3:.1f} ms", values=replace(contender.values, delay=delay))


calibrated = contenders[-1]
own = calibrated.values.delay
shifted = compare_bench([delayed(calibrated, one) for one in (0.0, own, own + 0.02)], bench)
trace = next(one for one in shifted.traces if one.run.trajectory == "sin_time_square" and "P32" in one.run.group)
figure, ax = plt.subplots(figsize=(11, 3), layout="constrained")
ax.plot(trace.run.t, trace.run.y, color="black", lw=3, alpha=0.4, label="measured")
for (name, reading), colour in zip(trace.readings.items(), (ORANGE, BLUE, GREEN), strict=True):
    ax.plot(trace.run.t, reading, color=colour, label=name)
ax.set(xlim=(4.4, 5.6), xlabel="time, s", ylabel="angle, rad", title=f"{trace.run.trajectory}, {trace.run.group}")
ax.legend(loc="upper right")
plt.show()

# %% [markdown]
# The error of each motion over the delay. *Look for* a sharp bottom, and for the same bottom in all of them. Slow
# motion (`up_and_down`) has a flat one: 5 ms of delay cost it 1 mrad, which any other error would hide.

# %%
delays = np.arange(0.0, 0.03, 0.001)
scan = compare_bench([delayed(calibrated, one) for one in delays], bench)
figure, ax = plt.subplots(figsize=(7, 3), layout="constrained")
for motion in sorted({run.trajectory for run in scan.runs}):
    names = [run.name for run in scan.runs if run.trajectory == motion]
    ax.semilogy(delays * 1e3, [1e3 * np.mean([e.by_run[n] for n in names]) for e in scan.errors.values()], label=motion)
ax.axvline(own * 1e3, color="black", lw=1, ls="--", label="calibrated")
ax.set(xlabel="command delay, ms", ylabel="mean error, mrad")
ax.legend(fontsize=7)
plt.show()

# %% [markdown]
# ## A whole robot, held by the trunk
#
# All 20 joints of a robot held upright. A log is simulated in pieces of a second or two, each begun at the measured
# state: lines break there. The robot fit takes the bench fits as they are and finds what only the robot tells:
# delays, joint zeros, scales of its own servos. It sees the first 30 % of the log; everything drawn below is the
# rest, which it never saw.

# %%
SEEN = 0.3
held, _, ground = read_log(ROBOT_LOG)
bench_fits = [load(path) for path in sorted(CALIBRATED.parent.glob("fits/mx*.json"))]
found = fit_robot(NOMINAL, bench_fits, [held], hold_out=1 - SEEN)
robots = {
    "nominal": robot_compare.of_model("nominal", NOMINAL),
    "calibrated": robot_compare.of_model("calibrated", CALIBRATED),
    "fitted": robot_compare.of_found(found, CALIBRATED)[-1],
}
over = {name: compare_robot(one, [held], None, last_share(1 - SEEN)) for name, one in robots.items()}
errors = {name: errors_by_channel(one) for name, one in over.items()}
pd.DataFrame({name: {"position, mrad": one["position"].mae * 1e3, "velocity, rad/s": one["velocity"].mae}
              for name, one in errors.items()}).T.round(4)  # fmt: skip

# %% [markdown]
# *Look for* a constant gap (a joint's zero: the calibrated model knows none), for a late flank (delays), for a joint
# that does not reach its goal (its servo is weaker than the one on the bench). *Wrong would be* a joint that is off
# in one direction of motion only: friction, or something that touches.

# %%
panel_figure(joint_panels(over, held.name, ("left_knee", "right_hip_roll", "left_shoulder_pitch", "right_elbow")))

# %% [markdown]
# Every joint. What stays of the calibrated model's error are the zeros of the joints, and servos that are not the one
# on the bench. The encoder's rounding alone is 0.4 mrad: the fitted robot is down to that.

# %%
joint_figure({name: one["position"].by_joint for name, one in errors.items()})

# %% [markdown]
# ## On its feet
#
# The same three robots, now standing, squatting and nodding: a log of which none of them saw anything. *Look for* a
# gyro that is as large and as late as the measured one. An error at every landing is contact, not servos.

# %%
over = {name: compare_robot(one, [ground], None, last_share(0.5)) for name, one in robots.items()}
panel_figure(trunk_panels(over, ground.name))

# %% [markdown]
# How old is the gyro? A held robot cannot tell, so the fitted one still has the nominal age. Here its age is changed
# by hand: the bottom of the curve is where simulated and measured shake together. *Try*: `"velocity"` of a joint, or
# `"orientation"`.

# %%
ages = np.linspace(0.03, 0.09, 6)
nods = {}
for age in ages:
    candidate = robots["fitted"].candidate
    other = replace(robots["fitted"], candidate=replace(candidate, ages={**candidate.ages, "gyro": age}))
    nods[age] = compare_robot(other, [ground], None, last_share(0.5))
figure, (left, right) = plt.subplots(1, 2, figsize=(11, 3), width_ratios=(1, 1.8), layout="constrained")
left.plot(ages * 1e3, [errors_by_channel(one)["gyro"].by_joint["y"] for one in nods.values()], "o-")
left.axvline(ground.truth.get("sensor.gyro_delay", np.nan) * 1e3, color="black", lw=1, ls="--", label="truth")
left.set(xlabel="age of the gyro, ms", ylabel="mean error, rad/s")
left.legend()
for age, colour in zip(ages[[0, 3, 5]], (ORANGE, BLUE, SKY), strict=True):
    line = series(nods[age], ground.name, "gyro", "y")
    right.plot(line.t, line.y + line.residuals, color=colour, lw=1.2, label=f"{age * 1e3:.0f} ms")
right.plot(line.t, line.y, color="black", lw=3, alpha=0.35, label="measured", zorder=0)
right.set(xlim=(13.0, 14.5), xlabel="time, s", ylabel="rate about y, rad/s")
right.legend()
plt.show()

# %% [markdown]
# ## What is left goes into training
#
# What the fits could not tell exactly, training draws anew for every robot: within the intervals, and together where
# numbers are tied. Each range stands in `robot_model/randomization.yaml` with where it comes from.

# %%
draws = load_calibration(CALIBRATED)
robots_drawn = [draws.sample(np.random.default_rng(seed)) for seed in range(500)]
gain, limit = (np.array([one[f"{bench.servo.name}.{field}"] for one in robots_drawn]) for field in ("kp", "forcerange"))
figure, ax = plt.subplots(figsize=(4.6, 3.4), layout="constrained")
ax.plot(gain, limit, ".", ms=4)
ax.set(xlabel="kp, N m/rad", ylabel="torque limit, N m", title=f"correlation {np.corrcoef(gain, limit)[0, 1]:.2f}")
plt.show()
