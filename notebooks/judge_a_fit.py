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
# # Judge a fit
#
# A fit always gives numbers. This notebook asks which of them to believe, and why: intervals, verdicts, what is tied
# to what, what a missing recording does, which friction law, and what to record next.
#
# The logs are simulated, so the truth is known and drawn where it helps. With your own there is no truth, and all you
# have is what this notebook looks at.

# %%
import os
from dataclasses import asdict
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from frasa_sysid.bench import bench_of
from frasa_sysid.bench_fit import choose_bench, fit_bench
from frasa_sysid.calibration.figures import BLUE, GREY, RED, wear_look
from frasa_sysid.identifiability import bench_findings, next_logs
from frasa_sysid.readers import read_log
from frasa_sysid.report_figures import choice_figure, correlation_figure, profile_figure
from frasa_sysid.report_verdicts import estimate_figure, verdict_figure
from frasa_sysid.signal_views import speed_torque

os.chdir(next(one for one in (Path.cwd(), *Path.cwd().parents) if (one / "robot_model").is_dir()))
wear_look()
pd.set_option("display.max_colwidth", None)

# %% [markdown]
# **What to change.** Other laws are `m1` to `m6`; effects are in the README (`sag`: the supply gives way under load).

# %%
LOG = Path("bench_logs/mx106.mcap")
LAW = "m1"  # the simplest: Coulomb and viscous friction, MuJoCo's own
RIVALS, EFFECTS = ("m1", "m4"), ("sag",)  # laws to choose from, and what is switched on beside them

# %% [markdown]
# ## The fit
#
# One call: CMA-ES, a least-squares finisher, and the evidence. Nominal is what the data sheet says. *Look for* an
# interval that excludes the nominal value: there the log knows better. *Wrong would be* a number on its bound, or far
# from nominal with a narrow interval and no reason: a wrong load in the log's facts does that.

# %%
recordings = read_log(LOG)
truth = recordings[0].truth
bench = bench_of(recordings)
simple = fit_bench(bench, LAW)
table = pd.DataFrame(asdict(one) for one in simple.evidence.estimates).set_index("name")
table[["nominal", "value", "low", "high", "unit", "verdict"]].round(5)

# %%
print(f"mean error: {simple.nominal.mae_rad * 1e3:.1f} mrad nominal, {simple.fitted.mae_rad * 1e3:.1f} mrad fitted")

# %% [markdown]
# ## What is tied to what
#
# How estimates move together. A pair near 1 or -1 does nearly the same to the motion: only a combination is known,
# however narrow each interval looks on its own. *Look for* gain against torque limit, delay against armature, dry
# against viscous friction.

# %%
names = [one.name for one in simple.evidence.estimates]
correlation_figure(names, simple.evidence.correlation)

# %% [markdown]
# The same without assuming that costs are parabolas: one number is held away from its best value and all others are
# fitted anew. *Look for* a valley with two walls. A flat floor means that the others make up for it. Dashed is where
# the interval would end.

# %%
profile_figure(simple.evidence.profiles, simple.solved.cost)

# %% [markdown]
# ## What a missing recording does
#
# The same fit on parts of the log. Green is identified (to 3 %), and the text is half of the 95 % interval. Empty is
# what was not asked: a motor that is never off has no friction of its own to fit.
#
# *Look for* the columns that lose their green. Without a run with the torque off, viscous friction cannot be told
# from the motor's back-EMF. With slow motion only, armature and torque limit are unknown: nothing accelerates,
# nothing saturates. *Try*: `one.rig.mass == 2.0`, or two runs only.

# %%
PARTS = {
    "all runs": lambda one: True,
    "never\ntorque off": lambda one: one.rig.trajectory != "lift_and_drop",
    "P = 8 only": lambda one: one.rig.firmware_gain == 8,
    "slow only": lambda one: one.rig.trajectory == "up_and_down",
    "light load,\nslow": lambda one: one.rig.mass < 1 and one.rig.trajectory == "up_and_down",
}
parts = {name: [one for one in recordings if keep(one)] for name, keep in PARTS.items()}
fits = {name: fit_bench(bench_of(kept), LAW, restarts=1) for name, kept in parts.items()}
cases = {name: fit.evidence.estimates for name, fit in fits.items()}
verdict_figure(cases)

# %% [markdown]
# Their intervals, with the truth dashed; hollow where the verdict is not *identified*. *Look at* how wide the poor
# logs are, and at something worse: intervals that are narrow and miss the truth. The law is too simple for this
# servo, and an interval is only about chance, given the law.

# %%
estimate_figure({name.replace("\n", " "): one for name, one in cases.items()}, truth)

# %% [markdown]
# What to record next, as the logs themselves say before any fit, and as the fit says for each number that it does not
# know.

# %%
for name, kept in parts.items():
    advice = next_logs(bench_findings(kept)) + [one.advice for one in fits[name].evidence.estimates if one.advice]
    print(name.replace("\n", " "), *list(dict.fromkeys(advice))[:3], sep="\n    ")

# %% [markdown]
# ## Which law
#
# A richer law always fits better. So runs are held out in turn, by load, by gain and by trajectory, and the law is
# judged on what it never saw. Each group of bars is one thing held out; the scale is logarithmic.
#
# *Look for* a law that wins everywhere, and for groups where none is good: without any drop (`lift_and_drop` held
# out) no law can know what it does with the torque off. *Wrong would be* a law that wins where it was fitted and
# loses where it was not.

# %%
choice = choose_bench(bench, RIVALS, EFFECTS)
laws = [one.law for one in choice.laws]
choice_figure(choice, choice.laws, laws.index(choice.problem.law))

# %%
print(choice.reason)
columns = ["law", "numbers", "all runs, mrad", "held out, mrad", "p"]
rows = [[one.law, one.numbers, one.train * 1e3, one.held_out * 1e3, one.p_value] for one in choice.laws]
pd.DataFrame(rows, columns=columns).set_index("law").round(3)

# %% [markdown]
# The chosen law beside the simple one, with the truth dashed. *Look at* the simple law: narrow intervals, far off. It
# has to press what it cannot say into the numbers it has. The rich law is within 1 % but for the delay, and yet some
# of its intervals miss: a fit at the robot's step of 2 ms keeps about half a step, 1 ms, in its delay (`frasa-sysid
# fit --timestep 0.0005` has none). What the robot is simulated with is what is fitted.

# %%
rich = fit_bench(bench, restarts=1, choice=choice)
both = {f"{LAW}": simple.evidence.estimates, " + ".join((rich.friction, *EFFECTS)): rich.evidence.estimates}
estimate_figure(both, truth, [name for name in names if name in truth])

# %% [markdown]
# And the friction that each law says over the speed, unloaded and with 3 N m on the shaft, on what the log shows of
# it: grey dots are all moments with the torque off (see [look at a log](look_at_a_log.ipynb)). The simple law draws
# one line through all loads. *Look for* dots that lie above every line: friction that no law here has.


# %%
def draw_law(ax, fit, colour):
    law = fit.problem.servo_values(fit.values).friction()
    for load, style in ((0.0, "-"), (3.0, "--")):
        bound = law.bound(np.zeros_like(speeds), np.full_like(speeds, load), speeds)
        ax.plot(speeds, bound, style, color=colour, lw=2, label=f"{fit.friction}, {load:g} N m")


speeds = np.linspace(0.0, 6.0, 200)
rotor = rich.values[[one.name for one in rich.evidence.estimates].index(f"{bench.servo.name}.armature")]
figure, ax = plt.subplots(figsize=(7, 3.4), layout="constrained")
for view in map(speed_torque, recordings):
    drag = view.torque + rotor * np.gradient(view.speed, view.t)
    ax.plot(np.abs(view.speed[view.free]), np.abs(drag[view.free]), ".", ms=2, color=GREY, alpha=0.6)
for fit, colour in ((simple, RED), (rich, BLUE)):
    draw_law(ax, fit, colour)
ax.set(xlabel="speed, rad/s", ylabel="friction, N m", xlim=(0, 6), ylim=(0, 1.0))
ax.legend()
plt.show()

# %% [markdown]
# ## What to believe
#
# 1. A verdict of *identified* is about chance: record it again, and the number comes out again.
# 2. Held-out error is about the law: a law that loses there gives numbers that stand for something else.
# 3. What neither the log nor the law says anything about stays at its nominal value, and training has to draw it from
#    a wide range.
#
# [Simulated over measured](simulated_over_measured.ipynb) shows what is left between the fit and the log.
