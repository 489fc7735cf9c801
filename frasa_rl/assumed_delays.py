"""Assumed ranges of delays, for models whose calibration has none of its own."""

from collections.abc import Collection

import mujoco
from numpy.random import Generator

from frasa_rl.config import Assumed, AssumedRanges
from frasa_rl.robot import Indices, Robot
from frasa_rl.servo_ratios import driven
from frasa_sysid.calibration import ModelError, actuators_of, servo_classes


class AssumedDelays:
    """Draws delays of commands and sensors and writes them into a model.

    Args:
        model: as it is now, it is the original.
        robot: which sensors are read.
        ranges: the assumed ones.
        measured: names of the parameters that have a measured range, which replace assumed ones.

    Raises:
        ModelError: the task does not read such a sensor, or a history buffer is too short for the range.
    """

    def __init__(self, model: mujoco.MjModel, robot: Robot, ranges: AssumedRanges, measured: Collection[str]) -> None:
        self._commands, self._sensors = _commands(model, measured), {}
        self._command_range = ranges.command_delay if self._commands.size else None
        if self._command_range is not None:
            buffers = {model.actuator(int(i)).name: int(model.actuator_history[i, 0]) for i in self._commands}
            _check(model, "command_delay", self._command_range, buffers)
        for name in ("position", "velocity", "gyro", "orientation"):
            one: Assumed | None = getattr(ranges, f"{name}_delay")
            if one is None or f"sensor.{name}_delay" in measured:
                continue
            ids = getattr(robot, name).ids.ravel()
            if not ids.size:
                raise ModelError(f"{name}_delay has a range, but names.{name} is null: the task reads no such sensor")
            buffers = {model.sensor(int(i)).name: int(model.sensor_history[i, 0]) for i in ids}
            _check(model, f"{name}_delay", one, buffers)
            self._sensors[f"{name}_delay"] = (ids, one)

    def draw(self, rng: Generator, model: mujoco.MjModel) -> dict[str, float]:
        """One delay for each kind [s], by name."""
        drawn = {}
        if self._command_range is not None:
            drawn["command_delay"] = value = float(rng.uniform(self._command_range.low, self._command_range.high))
            model.actuator_delay[self._commands] = value
        for name, (ids, one) in self._sensors.items():
            drawn[name] = value = float(rng.uniform(one.low, one.high))
            model.sensor_delay[ids] = value
        return drawn


def _commands(model: mujoco.MjModel, measured: Collection[str]) -> Indices:
    """Servos whose command delay was not measured."""
    known = {int(i) for name in servo_classes(model) if f"{name}.delay" in measured for i in actuators_of(model, name)}
    servos = driven(model)
    return servos[[int(i) not in known for i in servos]]


def _check(model: mujoco.MjModel, name: str, one: Assumed, buffers: dict[str, int]) -> None:
    shortest = min(buffers, key=lambda key: buffers[key])
    room = buffers[shortest] * float(model.opt.timestep)
    if one.high > room:
        samples = int(one.high / float(model.opt.timestep)) + 2
        raise ModelError(
            f"{name} reaches {one.high * 1e3:g} ms, but the history of {shortest} holds {room * 1e3:g} ms: give it "
            f'nsample="{samples}" and interp="linear"'
        )
