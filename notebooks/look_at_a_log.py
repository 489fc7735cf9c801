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
# # Look at a log
#
# Look before you fit. Ten minutes with a log tell what a fit of it can and cannot say, and what is wrong with the
# recording. This notebook looks at a bench log (one servo that swings a weight) and at a log of a whole robot, and
# then breaks a log on purpose, to show what is said about it.
#
# The logs here are simulated, with a known truth (`bench_logs/README.md`). Put your own in: change the names below
# and run all cells. `frasa-sysid inspect LOG` says in words what is drawn here.

# %%
import os
from dataclasses import asdict, replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from frasa_sysid.calibration.figures import BLUE, GREEN, GREY, ORANGE, RED, wear_look
from frasa_sysid.clocks import jitter
from frasa_sysid.errors import LogError
from frasa_sysid.identifiability import bench_findings, next_logs
from frasa_sysid.inspection import summarise
from frasa_sysid.joint_checks import checks
from frasa_sysid.lag import lags
from frasa_sysid.readers import read_log
from frasa_sysid.readers.columns import read_columns
from frasa_sysid.readers.csv_columns import CsvFile
from frasa_sysid.readers.signal_map import parse_map
from frasa_sysid.robot_findings import robot_findings
from frasa_sysid.signal_views import spectrum, speed_torque

os.chdir(next(one for one in (Path.cwd(), *Path.cwd().parents) if (one / "robot_model").is_dir()))
wear_look()
pd.set_option("display.max_colwidth", None, "display.precision", 3)

# %% [markdown]
# **What to change.** Paths are those of the repository.

# %%
LOG = Path("bench_logs/mx106.mcap")  # a bench: one servo
ROBOT_LOG = Path("bench_logs/robot.mcap")
RIG = 1.2  # load whose runs are drawn [kg]
GAIN = 8.0  # and their firmware gain

# %% [markdown]
# ## What is in it
#
# One file holds many runs. A run has one load, one firmware gain and one trajectory. Each cell counts runs.
#
# *Look for*: several loads and several gains. With one load, friction that grows with the load cannot be told from
# friction that does not; with one high gain, the gain itself hardly shows.

# %%
recordings = read_log(LOG)
rigs = pd.DataFrame(one.rig.known() for one in recordings)
rigs.pivot_table(index=["mass", "length"], columns="firmware_gain", values="trajectory", aggfunc="count")

# %% [markdown]
# The signals of one run. `quantum` is the step of the readings: 1.53 mrad is one count of a 12-bit encoder. A model
# can be right to a fraction of it, a single reading cannot.

# %%
one_rig = [one for one in recordings if (one.rig.mass, one.rig.firmware_gain) == (RIG, GAIN)]
columns = ["name", "unit", "samples", "period_median", "period_max", "low", "high", "quantum"]
pd.DataFrame([asdict(summarise(one)) for one in one_rig[0].signals.values()])[columns]

# %% [markdown]
# ## The motion
#
# Every trajectory of that load and gain: what was asked in orange, what was measured in black, grey where the torque
# is off.
#
# *Look for*: an arm that lags and overshoots (a soft servo shows its gain), one that turns back often (friction), one
# that falls freely (damping without the motor's own). *What would be wrong*: a goal that the arm never follows, a
# constant gap (a zero error, or a gain so low that gravity wins), steps in the measured line.


# %%
def draw_motion(ax, one):
    goal, position, enable = (one.signals[name] for name in ("goal", "position", "torque_enable"))
    ax.fill_between(enable.t, -2.0, 2.0, where=enable.y < 0.5, color=GREY, alpha=0.25, lw=0)
    ax.plot(goal.t, goal.y, color=ORANGE, lw=1.2, label="goal")
    ax.plot(position.t, position.y, color="black", lw=1.4, label="measured")
    ax.set(title=f"{one.name}: {one.rig.trajectory}", xlabel="time, s", ylabel="angle, rad", ylim=(-2.0, 2.0))


figure, axes = plt.subplots(2, 2, figsize=(11, 5), layout="constrained")
for ax, one in zip(axes.flat, one_rig, strict=False):
    draw_motion(ax, one)
axes[0, 0].legend(loc="upper right")
plt.show()

# %% [markdown]
# ## The clock
#
# How far apart are two readings? The loop was to run at 100 Hz. It runs a little late, by chance, as every loop
# without a real-time clock does: that is no fault, as long as the *stamps* are true. frasa simulates at the stamps
# and never resamples a log.
#
# *What would be wrong*: a second hump at twice the period (lost readings), a smear of several milliseconds with the
# same stamp (a recorder's clock instead of the servo's), two humps (two rates in one log).

# %%
steps = np.concatenate([np.diff(one.signal("position").t) for one in recordings]) * 1e3
figure, (left, right) = plt.subplots(1, 2, figsize=(11, 2.6), layout="constrained")
left.hist(steps, bins=120, color=BLUE)
left.set(title="Between two readings, all runs", xlabel="ms", ylabel="readings", yscale="log")
for one in one_rig:
    t = one.signal("position").t
    right.plot(t[1:], np.diff(t) * 1e3, ".", ms=2.5, label=one.rig.trajectory)
right.set(title="Along four runs", xlabel="time, s", ylabel="ms")
pd.DataFrame({name: jitter(one.t) for name, one in one_rig[0].signals.items()}).T

# %% [markdown]
# ## What moves fast enough
#
# The spectra of goal and position. Where both lie on each other the servo follows, and only friction shows. Where the
# position leaves the goal, gain, inertia and delay show.
#
# *Look for*: power above 1 Hz in at least one trajectory. `up_and_down` alone has none: a log of it would tell the
# gain and the friction, and no delay.

# %%
figure, axes = plt.subplots(1, len(one_rig), figsize=(11, 2.7), sharey=True, layout="constrained")
for ax, one in zip(axes, one_rig, strict=True):
    for name, colour in (("goal", ORANGE), ("position", "black")):
        ax.loglog(*spectrum(one.signal(name)), color=colour, lw=1.3, label=name)
    ax.set(title=one.rig.trajectory, xlabel="frequency, Hz", xlim=(0.3, 30), ylim=(1e-5, 3))
axes[0].set_ylabel("rad per root Hz")
axes[0].legend()
plt.show()

# %% [markdown]
# ## Torque over speed
#
# From angles alone: what carries and accelerates the load is inertia times acceleration plus gravity, and it all came
# through the horn of the servo. Each dot is a moment.
#
# Left, under power: the cloud has to stay inside what the motor can do, its torque limit less back-EMF (dashed, by
# the numbers of the data sheet). *Look for* dots near the edge: only there does the torque limit show. Right, the
# torque is off: nothing but friction and the rotor hold the arm back, always against the motion. The rotor's part is
# taken off with its nominal inertia. *Look for* a step at standstill (dry friction), a slope (viscous friction), and
# more of both with more load.

# %%
LIMIT, BACK_EMF, ROTOR = 13.6, 2.15, 0.025  # of an MX-106 at 15 V [N m, N m s/rad, kg m^2]


def draw_planes(left, right, runs, colour):
    views = [speed_torque(one) for one in runs]
    for one in views:
        left.plot(one.speed[one.powered], one.torque[one.powered], ".", ms=1.2, color=colour)
        drag = one.torque + ROTOR * np.gradient(one.speed, one.t)
        right.plot(one.speed[one.free][5:-5], drag[one.free][5:-5], ".", ms=2.5, color=colour)
    right.plot([], [], "o", color=colour, label=f"{runs[0].rig.mass:g} kg at {runs[0].rig.length:g} m")


figure, (left, right) = plt.subplots(1, 2, figsize=(11, 3.8), layout="constrained")
for mass, colour in zip(sorted(rigs.mass.unique(), reverse=True), (RED, GREEN, BLUE), strict=False):
    draw_planes(left, right, [one for one in recordings if one.rig.mass == mass], colour)
for sign in (-1, 1):
    left.plot([-8, 8], [sign * LIMIT + 8 * BACK_EMF, sign * LIMIT - 8 * BACK_EMF], "--", color=GREY, lw=1.2)
left.set(title="Under power", xlabel="speed, rad/s", ylabel="torque on the load, N m", xlim=(-8, 8), ylim=(-12, 12))
right.set(title="Torque off: friction", xlabel="speed, rad/s", ylabel="N m", ylim=(-1.2, 1.2))
right.legend()
plt.show()

# %% [markdown]
# ## What it can tell
#
# The same in words, one rule for each number of the fit, before any fit: `yes`, `weak` or `no`, and why.

# %%
found = bench_findings(recordings)
pd.DataFrame(asdict(one) for one in found)[["parameter", "verdict", "reason"]]

# %%
print("Record next:", *next_logs(found), sep="\n  ")

# %% [markdown]
# Now less of it. Each column is a log that somebody might have recorded; where it says less than the whole, another
# motion is needed. *Try*: a subset of your own.

# %%
SUBSETS = {
    "all runs": recordings,
    "never torque off": [one for one in recordings if one.rig.trajectory != "lift_and_drop"],
    "slow only": [one for one in recordings if one.rig.trajectory == "up_and_down"],
    "one light load": [one for one in recordings if one.rig.mass == min(rigs.mass)],
    "P = 8 only": [one for one in recordings if one.rig.firmware_gain == 8],
}
pd.DataFrame({name: {one.parameter: one.verdict for one in bench_findings(runs)} for name, runs in SUBSETS.items()})

# %%
for name, runs in SUBSETS.items():
    print(f"{name}: {(next_logs(bench_findings(runs)) or ['nothing'])[0]}")

# %% [markdown]
# ## A whole robot
#
# Three runs of one robot: held upright, held face down, on its feet. Every channel has a clock of its own. Below: a
# hip and a knee on the ground, with their goals, and the rate that the gyro saw.
#
# *Look for*: joints that follow; a gyro that moves, but does not shake when the robot stands still.

# %%
robots = read_log(ROBOT_LOG)
pd.DataFrame(
    {"run": one.name, "base": one.rig.base, "P": one.rig.firmware_gain, "s": round(one.duration, 1)} for one in robots
)

# %%
ground, JOINTS = robots[-1], ("left_hip_pitch", "left_knee")
goal, position, gyro = (ground.signal(name) for name in ("goal", "position", "gyro"))
figure, axes = plt.subplots(3, 1, figsize=(11, 5), sharex=True, layout="constrained")
for ax, joint in zip(axes, JOINTS, strict=False):
    ax.plot(goal.t, goal.y[:, goal.columns.index(joint)], color=ORANGE, lw=1.1, label="goal")
    ax.plot(position.t, position.y[:, position.columns.index(joint)], color="black", lw=1.1, label="measured")
    ax.set(title=joint, ylabel="angle, rad")
axes[-1].plot(gyro.t, gyro.y, lw=0.9, label=[f"about {axis}" for axis in gyro.columns])
axes[-1].set(title="gyro", ylabel="rad/s", xlabel="time, s")
axes[0].legend(ncols=2), axes[-1].legend(ncols=3)
plt.show()

# %% [markdown]
# A delay is one channel shown later than another. Here: how old a joint's velocity is beside its position. The
# verdict says whether it is a delay at all (it could be a filter, or too slow to tell). *Try*: `"position"` against
# `"goal"`.

# %%
late = lags(robots[:1], "velocity", "position")
table = pd.DataFrame(asdict(one) for one in late).set_index("joint")
(table[["delay", "low", "high"]] * 1e3).round(2).assign(verdict=table.verdict).head(8)  # [ms]

# %%
pd.DataFrame(asdict(one) for one in robot_findings(robots))[["parameter", "verdict", "reason"]]

# %% [markdown]
# ## What is wrong with a log
#
# Recorders crash, disks fill up, cables come loose. Four damaged logs, and what is said about each.
#
# **Cut off.** The recorder died: the end of the file is missing, its index too. What came through is read, and what
# was lost is counted.

# %%
damaged = Path("runs/damaged")
damaged.mkdir(parents=True, exist_ok=True)
(damaged / "cut.mcap").write_bytes(LOG.read_bytes()[: LOG.stat().st_size * 6 // 10])
cut = read_log(damaged / "cut.mcap")
print(f"{len(cut)} of {len(recordings)} runs")
for fault in dict.fromkeys((fault.code, fault.message) for one in cut for fault in one.faults):
    print(f"  {fault[0]}: {fault[1]}")

# %% [markdown]
# **A flipped bit.** Chunks carry a checksum. A log that does not match it is refused: nobody knows what else it got
# wrong.

# %%
broken = bytearray(LOG.read_bytes())
broken[len(broken) // 2] ^= 0x10
(damaged / "bit.mcap").write_bytes(broken)
try:
    read_log(damaged / "bit.mcap")
except LogError as error:
    print(error)

# %% [markdown]
# **Not a number.** A table with readings that failed, a stamp that came twice and a row that was cut off. A small map
# says what the columns are (`frasa-sysid import` takes the same two files). What is dropped is counted.

# %%
MAP = """
time = { column = "t", unit = "s" }
signal = [{ column = "q", signal = "position", unit = "deg" }, { column = "goal", signal = "goal", unit = "deg" }]
"""
position, goal = (one_rig[1].signal(name) for name in ("position", "goal"))
table = pd.DataFrame({"t": position.t, "q": np.degrees(position.y), "goal": np.degrees(goal.y)}).round(4)
table.loc[100:119, "q"] = np.nan
table.loc[200, "t"] = table.loc[199, "t"]
(damaged / "nan.csv").write_text(table.to_csv(index=False)[:-12])
imported = read_columns(CsvFile(damaged / "nan.csv"), parse_map("map.toml", MAP.encode(), builtin=False))[0]
for fault in imported.faults:
    print(f"{fault.code}: {fault.message}")

# %% [markdown]
# **A joint that turns the wrong way.** The file is sound, the mapping is not: one sign is wrong, as after a servo was
# mounted the other way round. A fit would bend every other number to make up for it, so it is refused.

# %%
position = robots[0].signal("position")
turned = position.y.copy()
turned[:, position.columns.index("left_knee")] *= -1
wrong = replace(robots[0], signals={**robots[0].signals, "position": replace(position, y=turned)})
for check in checks(wrong):
    print(f"{check.level}: {check.message}")

# %% [markdown]
# ## Next
#
# [Judge a fit](judge_a_fit.ipynb) shows what such logs come to: intervals, verdicts, and what is missing.
