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
# # Watch a policy
#
# The policy in the box stands up from its front and its back, and is pushed. See what it does, what it asks of the
# servos, how it compares with a hand-written routine of keyframes and with the paper's numbers, and what happens on a
# robot with weaker servos, which it was never trained on.
#
# Where this machine draws without a window there are pictures, else stick figures. `frasa-rl play` writes films,
# `frasa-rl evaluate` the paper's tables with all trials.

# %%
import os
from pathlib import Path

import frasa_rl  # first of all: MuJoCo is told here to draw without a window

os.chdir(next(one for one in (Path.cwd(), *Path.cwd().parents) if (one / "robot_model").is_dir()))

# isort: split
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from frasa_rl.evaluate import find_controller
from frasa_rl.protocol import PAPER_PUSH, PAPER_STANDUP, Conditions, evaluation_task
from frasa_rl.watch import watch_push, watch_standup
from frasa_rl.watch_figures import action_figure, strip_figure, watched_figure
from frasa_sysid.calibration.figures import BLUE, GREY, ORANGE, RED, wear_look

wear_look()

# %% [markdown]
# **What to change.** A policy of your own is the folder of a run (`runs/first`). The push: `front` or `back`, up to
# 7.3 J.

# %%
POLICY = "robot_model/policies/standup/policy"
MODEL, WEAKER = Path("robot_model/calibrated.xml"), Path("robot_model/nominal.xml")
PUSH = ("front", 5.5)
SEED = 10_000  # of the falls; the protocol's own begin here

# %%
task = evaluation_task(frasa_rl.Task())
policy, _ = find_controller(POLICY, MODEL, task)
keyframes, _ = find_controller("keyframes", MODEL, task)
conditions = Conditions(MODEL, task, seed=SEED)

# %% [markdown]
# ## Standing up
#
# From prone. *Look for* feet under the body before the trunk rises, and arms that push. *Wrong would be* a jump, a
# robot that slides, or one that stands only with its arms moving for balance.

# %%
prone = watch_standup(policy, conditions, "prone", more_s=0.3, textures=True)
strip_figure(prone.until_decided(), f"from prone: {prone.words}")

# %% [markdown]
# From supine: it has to get over its feet backwards.

# %%
supine = watch_standup(policy, conditions, "supine", more_s=0.3, textures=True)
strip_figure(supine.until_decided(), f"from supine: {supine.words}")

# %% [markdown]
# The same as sticks, as a machine without OpenGL shows it: blue the right side, grey dots the collision shapes.

# %%
strip_figure(supine.until_decided(), sticks=True)

# %% [markdown]
# ## What it does
#
# Every decision: how fast each joint's command is to move, as a share of the rate limit. *Look for* a quiet end: a
# policy that shakes where it stands wears out its servos. *Wrong would be* colours that change at every step
# (chatter).

# %%
action_figure(supine)

# %% [markdown]
# Trunk and joints over time; commands are dotted. It stands where the largest error stays below 5 deg.
#
# *Look for* the distance between dotted and full: that is what a servo under load and a delay make of a command.
# *Wrong would be* a command far beyond what the joint can do, held for long: on the robot that is a hot servo.

# %%
watched_figure({"prone": prone, "supine": supine})

# %% [markdown]
# ## A push
#
# A pendulum of 0.9 kg hits the trunk, as in the paper. *Look for* a step or a crouch, and for arms against the fall.
# If it falls, it has to stand up again, and the clock runs on.

# %%
pushed = watch_push(policy, conditions, PUSH, more_s=0.3, textures=True)
title = f"pushed from the {PUSH[0]} with {PUSH[1]} J, unstable for: {pushed.words}"
strip_figure(pushed.between(0.5, pushed.t[-1]), title, push=True)

# %% [markdown]
# ## Beside a routine of keyframes
#
# Keyframes are postures and times, tuned offline. They are the same however the robot lies; the policy sees where it
# is. *Look at* the waits: a routine has to wait for the slowest case.

# %%
routine = {side: watch_standup(keyframes, conditions, side, more_s=0.3) for side in ("prone", "supine")}
figure, axes = plt.subplots(1, 2, figsize=(11, 2.8), sharey=True, layout="constrained")
for ax, (side, mine) in zip(axes, {"prone": prone, "supine": supine}.items(), strict=True):
    for name, one, colour in (("policy", mine, BLUE), ("keyframes", routine[side], RED)):
        ax.plot(one.t, one.height, color=colour, label=f"{name}: {one.words}")
    ax.set(title=f"from {side}", xlabel="time, s", ylabel="height of the trunk, m")
    ax.legend(loc="lower right")
plt.show()

# %% [markdown]
# ## Other servos
#
# The nominal model has the servos of the data sheet, weaker than the calibrated ones, and not those of the training.
# A policy that only works on the model it was trained on is not worth taking to a robot.

# %%
stranger, _ = find_controller(POLICY, WEAKER, task, allow_other_model=True)
weaker = watch_standup(stranger, Conditions(WEAKER, task, seed=SEED), "supine", more_s=0.3, textures=True)
watched_figure({"calibrated": supine, "nominal": weaker})

# %%
strip_figure(weaker, f"from supine on the nominal model: {weaker.words}")

# %% [markdown]
# ## Beside the paper
#
# One trial each, against means of the paper (FRASA, arXiv 2410.08655), which were measured on the robot itself: ours
# are simulated. *Do not* take one trial for a result: `frasa-rl evaluate POLICY --trials 20` has them all.

# %%
rows = {
    "prone": (prone.time_s, routine["prone"].time_s, *(one[0] for one in PAPER_STANDUP["prone"].values())),
    "supine": (supine.time_s, routine["supine"].time_s, *(one[0] for one in PAPER_STANDUP["supine"].values())),
    f"{PUSH[0]} {PUSH[1]} J": (pushed.time_s, np.nan, PAPER_PUSH.get(PUSH, np.nan), np.nan),
}
columns = ["policy, s", "keyframes, s", *(f"paper: {name}, s" for name in PAPER_STANDUP["prone"])]
table = pd.DataFrame(rows.values(), rows.keys(), columns).astype(float)
table.plot.barh(figsize=(7, 2.6), color=[BLUE, GREY, ORANGE, "#d9dee3"], width=0.8, xlabel="s").invert_yaxis()
plt.show()
table.round(2)
