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
# # Simulated over measured
#
# A bench log, what the nominal model makes of it, and what the calibrated model makes of it. Change the log, the runs
# or a number, and look again. (The logs here are simulated with a known truth: see `bench_logs/README.md`.)

# %%
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from frasa_sysid.bench_session import BenchSession
from frasa_sysid.calibration import SERVO_FIELDS, load_calibration, load_model, read
from frasa_sysid.cost import misfit
from frasa_sysid.problem import stated_servo
from frasa_sysid.readers import read_log
from frasa_sysid.rig import runs_of
from frasa_sysid.servo_values import ServoValues
from frasa_sysid.stored_fit import load

root = Path.cwd() if (Path.cwd() / "robot_model").is_dir() else Path.cwd().parent
model_folder = root / "robot_model"
name = "mx106"

# %% [markdown]
# ## The log
# One file, many runs: each with its load, firmware gain and trajectory.

# %%
recordings = read_log(root / "bench_logs" / f"{name}.mcap")
print(len(recordings), "runs, origin:", recordings[0].origin)
for recording in recordings[::9]:
    print(recording.name, recording.rig.trajectory, recording.rig.mass, "kg, P", recording.rig.firmware_gain)

# %% [markdown]
# ## Two servos: nominal, and as published in `calibrated.xml`

# %%
servo, nominal = stated_servo(name, model_folder / "nominal.xml")
before = ServoValues(**nominal)
model = load_model(model_folder / "calibrated.xml")
fit = load(model_folder / "fits" / f"{name}.json")
after = replace(
    before,
    **{field: read(model, f"{name}.{field}") for field in SERVO_FIELDS},
    offset=fit.parameters["bench.offset"]["value"],
    damping_off=fit.parameters[f"{name}.damping_off"]["value"],
)
for field in SERVO_FIELDS:
    print(f"{field:>13}: {getattr(before, field):8.4g} nominal, {getattr(after, field):8.4g} calibrated")

# %%
with BenchSession(model_folder / "bench_pendulum.xml", servo) as session:
    runs = runs_of(recordings, servo, session.options.timestep)
    simulated = session.split(session.kernel(runs), np.array([before.array(), after.array()]))
for label, readings in zip(("nominal", "calibrated"), simulated, strict=True):
    print(f"{label:>11}: mean error {misfit(runs, readings).mae_rad * 1e3:5.1f} mrad over {len(runs)} runs")

# %%
chosen = [0, 13, 22, 35]
figure, axes = plt.subplots(len(chosen), 2, figsize=(12, 2.6 * len(chosen)), sharex=True, layout="constrained")
for (left, right), i in zip(axes, chosen, strict=True):
    left.plot(runs[i].t, runs[i].y, color="black", alpha=0.4, lw=3, label="measured")
    for label, colour, readings in zip(("nominal", "calibrated"), ("#c44e52", "#1f77b4"), simulated, strict=True):
        left.plot(runs[i].t, readings[i], color=colour, label=label)
        right.plot(runs[i].t, (readings[i] - runs[i].y) * 1e3, color=colour)
    left.set(title=f"{runs[i].trajectory}, {runs[i].group}", ylabel="angle [rad]")
    right.set(ylabel="simulated - measured [mrad]")
axes[0, 0].legend()
plt.show()

# %% [markdown]
# ## The ranges that training draws from
# Where each comes from stands beside it in `randomization.yaml`.

# %%
calibration = load_calibration(model_folder / "calibrated.xml")
draws = [calibration.sample(np.random.default_rng(seed)) for seed in range(500)]
kp, damping = (np.array([draw[f"{name}.{field}"] for draw in draws]) for field in ("kp", "damping"))
plt.figure(figsize=(5, 4), layout="constrained")
plt.scatter(kp, damping, s=6)
plt.xlabel("kp [N m/rad]")
plt.ylabel("damping [N m s/rad]")
plt.title(f"drawn together, correlation {np.corrcoef(kp, damping)[0, 1]:.2f}")
plt.show()
