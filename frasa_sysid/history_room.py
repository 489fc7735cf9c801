"""How many samples delayed sensors and servos have to keep, so that no delay of a range is cut in silence."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import ceil
from pathlib import Path

import mujoco
import numpy as np

from frasa_sysid.calibration import (
    ModelError,
    Range,
    actuators_of,
    delayed_sensors,
    load_model,
    load_spec,
    parameter,
)
from frasa_sysid.calibration.parameters import SENSOR_FIELDS

MARGIN = 1.1  # [1] of the longest delay of a range ...
SPARE = 2  # ... and so many samples more
SENSOR_TAGS = {
    "position_delay": "jointpos",
    "velocity_delay": "jointvel",
    "gyro_delay": "gyro",
    "orientation_delay": "framequat",
}


@dataclass(frozen=True)
class HistoryRoom:
    """Samples to keep.

    Attributes:
        sensors: by field of `SENSOR_FIELDS`.
        servos: by servo class.
    """

    sensors: dict[str, int]
    servos: dict[str, int]


def room_for(model: mujoco.MjModel, longest: Mapping[str, float]) -> HistoryRoom:
    """Samples that hold the longest delays, and never fewer than the model keeps already.

    Args:
        model: the nominal one.
        longest: longest delay [s] by parameter name, of sensors and servos.

    Raises:
        ModelError: no such servo class.
    """
    sensors, servos = {}, {}
    for name, delay in longest.items():
        one = parameter(name)
        needed = ceil(MARGIN * delay / model.opt.timestep) + SPARE
        if one.field in SENSOR_FIELDS:
            kept = model.sensor_history[delayed_sensors(model, one.field), 0]
            sensors[one.field] = int(max(needed, *kept)) if kept.size else needed
        else:
            servos[one.owner] = int(max(needed, *model.actuator_history[actuators_of(model, one.owner), 0]))
    return HistoryRoom(sensors, servos)


def longest_delays(ranges: Mapping[str, Range], names: Mapping[str, float]) -> dict[str, float]:
    """Longest delay [s] of each of the named parameters that is one: of its range, or its value [s]."""
    delays = {name: value for name, value in names.items() if parameter(name).field.endswith("delay")}
    return {name: max(value, ranges[name].high) if name in ranges else value for name, value in delays.items()}


def widened(nominal: Path, room: HistoryRoom) -> mujoco.MjModel:
    """The nominal model with room for delays: what a published one is held against."""
    plain = load_model(nominal)
    spec = load_spec(nominal)
    for field, count in room.sensors.items():
        for i in delayed_sensors(plain, field):
            spec.sensors[i].nsample, spec.sensors[i].interp = count, 1
    for servo, count in room.servos.items():
        for i in actuators_of(plain, servo):
            spec.actuators[i].nsample, spec.actuators[i].interp = count, 1
    model: mujoco.MjModel = spec.compile()
    if not np.array_equal(model.sensor_type, plain.sensor_type):
        raise ModelError(f"{nominal}: its sensors are compiled in another order than they are written")
    return model
