"""What delayed sensors and actuators remember when a simulation begins.

MuJoCo's history buffers are zeros after a reset, quaternions too, until the first delay has passed:
a robot would be told to go to zero first, and would read zeros or, where only part of a buffer is
overwritten, another episode.
"""

import mujoco
import numpy as np
import numpy.typing as npt


def hold_history(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Fill every history buffer as if robot and commands had always been what they are now.

    Whatever the delays are, or are set to later within the buffers, the first reading is that of the
    present state, and the first command acted on is the present one.

    Args:
        model: its sensor delays are set to zero for a moment: no other thread may use it meanwhile.
        data: with `time`, `qpos`, `qvel`, `act` and `ctrl` as they shall be; left as after `mj_forward`.
    """
    for i in np.flatnonzero(model.actuator_history[:, 0] > 0):
        times = _times(model, data, int(model.actuator_history[i, 0]))
        mujoco.mj_initCtrlHistory(model, data, i, times, np.full((times.size, 1), data.ctrl[i]))
    present = _undelayed(model, data)
    for i in np.flatnonzero(model.sensor_history[:, 0] > 0):
        times = _times(model, data, int(model.sensor_history[i, 0]))
        start = model.sensor_adr[i]
        samples = np.tile(present[start : start + model.sensor_dim[i]], (times.size, 1))
        mujoco.mj_initSensorHistory(model, data, i, times, samples, float(times[-1, 0]))
    mujoco.mj_forward(model, data)


def _times(model: mujoco.MjModel, data: mujoco.MjData, count: int) -> npt.NDArray[np.float64]:
    """When the samples of a full buffer were taken [s], shape (count, 1): up to one step ago."""
    times: npt.NDArray[np.float64] = data.time - model.opt.timestep * np.arange(count, 0.0, -1.0)[:, None]
    return times


def _undelayed(model: mujoco.MjModel, data: mujoco.MjData) -> npt.NDArray[np.float64]:
    """Every sensor's present value, shape (nsensordata,)."""
    delays = model.sensor_delay.copy()
    try:
        model.sensor_delay[:] = 0.0
        mujoco.mj_forward(model, data)
    finally:
        model.sensor_delay[:] = delays
    present: npt.NDArray[np.float64] = data.sensordata.copy()
    return present
