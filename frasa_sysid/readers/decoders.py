"""Bytes of one message -> named numbers, for the message types that frasa understands, or by a map.

`decoder_for` goes by (message encoding, schema encoding); what comes out is the same for
ROS 2, JSON, MessagePack and Protobuf: a header stamp where there is one, and readings,
each a quantity with the joints (or axes) it belongs to.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stderr
from dataclasses import dataclass
from io import StringIO
from types import SimpleNamespace
from typing import Any, NamedTuple

from mcap.records import Channel, Schema
from mcap_ros2.decoder import DecoderFactory

from frasa_sysid.readers.payloads import UNPACKS, Unpack
from frasa_sysid.readers.stamps import stamp_of

XYZ = ("x", "y", "z")
LARGEST = {"cdr": 2**16, "protobuf": 2**20}  # bytes of a definition; that of a whole planning scene is half of it
WXYZ = ("w", "x", "y", "z")
COMMAND_WORDS = ("command", "cmd", "goal", "target", "desired", "reference", "setpoint", "lead", "leader")


class Reading(NamedTuple):
    """One quantity of one message.

    Attributes:
        name: of the signal it belongs to.
        unit: as fixed by the message type; None where the type leaves it open.
        columns: joints or axes.
        values: one for each column.
    """

    name: str
    unit: str | None
    columns: tuple[str, ...]
    values: Sequence[float]


@dataclass(frozen=True)
class Decoded:
    """What one message says: stamp [ns] (None without a header, 0 when not filled in) and readings."""

    stamp: int | None
    readings: list[Reading]


Decode = Callable[[bytes], Decoded]
Extract = Callable[[Any, str], Decoded]


def decoder_for(
    channel: Channel, schema: Schema | None, ros2: DecoderFactory, chosen: Extract | None = None, by_type: bool = True
) -> Decode | None:
    """The function that decodes the messages of a channel, or None when it holds nothing for us.

    Args:
        channel: of the messages.
        schema: of the channel, if it has one.
        ros2: the decoder of this file; it remembers definitions by schema id.
        chosen: what a map reads from this topic.
        by_type: without a map: the message type says what is read.

    Raises:
        LogError: a package for this encoding is not installed.
        Exception: whatever the library raises on a definition it cannot parse.
    """
    encoding = channel.message_encoding.lower()
    kind = _short(schema.name) if schema else ""
    extract = chosen or (_extract_by_type(encoding, kind) if by_type else None)
    if extract is None:
        return None
    if schema is not None and len(schema.data) > LARGEST.get(encoding, LARGEST["cdr"]):
        raise ValueError(f"a definition of {len(schema.data)} bytes")
    unpack: Unpack | None
    if encoding == "cdr":
        with redirect_stderr(StringIO()):  # the parser prints what it then raises
            unpack = ros2.decoder_for(channel.message_encoding, schema)
    else:
        make = UNPACKS.get((encoding, schema.encoding if schema else ""))
        unpack = None if make is None else make(schema)
    if unpack is None:
        return None
    topic, plain = channel.topic, encoding != "cdr" and chosen is None
    return lambda data: extract(_namespace(unpack(data)) if plain else unpack(data), topic)


def _extract_by_type(encoding: str, kind: str) -> Extract | None:
    """What reads a message type; what has no definition and looks like a JointState is taken for one."""
    return EXTRACTORS.get(kind, _joint_state if encoding in ("json", "msgpack", "messagepack") else None)


def extract_ros(kind: str) -> Extract | None:
    """What reads a ROS message type such as `sensor_msgs/msg/JointState`, or None."""
    return EXTRACTORS.get(_short(kind))


def _short(type_name: str) -> str:
    """`sensor_msgs/msg/JointState` and `sensor_msgs/JointState` are one type."""
    return type_name.replace("/msg/", "/")


def _namespace(value: Any) -> Any:  # noqa: ANN401 - whatever JSON holds
    if isinstance(value, dict):
        return SimpleNamespace(**{str(key): _namespace(one) for key, one in value.items()})
    if isinstance(value, list):
        return [_namespace(one) for one in value]
    return value


def is_command(topic: str) -> bool:
    """Whether a topic's name says that it carries goals rather than measurements."""
    words = topic.lower().replace("/", "_").split("_")
    return any(word.rstrip("s") in COMMAND_WORDS for word in words)


def _names(names: Any, count: int) -> tuple[str, ...]:  # noqa: ANN401
    given = tuple(str(name) for name in names or ())
    return given if given else tuple(str(i) for i in range(count))


JOINT_UNITS = {"position": "rad", "velocity": "rad/s", "acceleration": "rad/s^2", "effort": "raw"}


def _joint_readings(columns: Any, arrays: Mapping[str, Any], command: bool) -> list[Reading]:  # noqa: ANN401
    readings = []
    for quantity, values in arrays.items():
        # A JointState may leave any of its arrays empty; that quantity is just absent.
        if values is None or len(values) == 0:
            continue
        names = _names(columns, len(values))
        if len(names) != len(values):
            raise ValueError(f"{len(names)} names but {len(values)} values of {quantity}")
        name = {"position": "goal"}.get(quantity, f"goal_{quantity}") if command else quantity
        readings.append(Reading(name, JOINT_UNITS[quantity], names, values))
    return readings


def _joint_state(message: Any, topic: str) -> Decoded:  # noqa: ANN401
    arrays = {quantity: getattr(message, quantity, None) for quantity in ("position", "velocity", "effort")}
    return Decoded(stamp_of(message), _joint_readings(getattr(message, "name", None), arrays, is_command(topic)))


def _joint_command(message: Any, topic: str) -> Decoded:  # noqa: ANN401
    arrays = {"position": message.positions, "velocity": message.velocities}
    return Decoded(stamp_of(message), _joint_readings(message.joint_names, arrays, command=True))


def _foxglove_joint_states(message: Any, topic: str) -> Decoded:  # noqa: ANN401
    readings = []
    for quantity in ("position", "velocity", "acceleration", "effort"):
        pairs = [(joint.name, getattr(joint, quantity, None)) for joint in message.joints]
        known = [(name, value) for name, value in pairs if value is not None]
        arrays = {quantity: [value for _, value in known]}
        readings += _joint_readings([name for name, _ in known], arrays, is_command(topic))
    return Decoded(stamp_of(message), readings)


def _dynamic_joint_state(message: Any, topic: str) -> Decoded:  # noqa: ANN401
    found: dict[str, tuple[list[str], list[float]]] = {}
    for joint, one in zip(message.joint_names, message.interface_values, strict=True):
        for interface, value in zip(one.interface_names, one.values, strict=True):
            joints, values = found.setdefault(interface, ([], []))
            joints.append(joint)
            values.append(value)
    return Decoded(
        stamp_of(message), [Reading(name, None, tuple(joints), values) for name, (joints, values) in found.items()]
    )


def _controller_state(message: Any, topic: str) -> Decoded:  # noqa: ANN401
    # Called desired/actual up to ROS 2 Humble, reference/feedback since.
    goal = getattr(message, "reference", None) or getattr(message, "desired", None)
    arrays = {"position": getattr(goal, "positions", None), "velocity": getattr(goal, "velocities", None)}
    return Decoded(stamp_of(message), _joint_readings(message.joint_names, arrays, command=True))


def _joint_trajectory(message: Any, topic: str) -> Decoded:  # noqa: ANN401
    # Several points are a plan, not what the servo is told now.
    arrays = {"position": message.points[0].positions} if len(message.points) == 1 else {}
    return Decoded(stamp_of(message), _joint_readings(message.joint_names, arrays, command=True))


def _multi_array(message: Any, topic: str) -> Decoded:  # noqa: ANN401
    arrays = {"position": message.data} if is_command(topic) else {}
    return Decoded(None, _joint_readings(None, arrays, command=True))


IMU_FIELDS = (
    ("gyro", "rad/s", "angular_velocity", XYZ),
    ("acceleration", "m/s^2", "linear_acceleration", XYZ),
    ("orientation", "1", "orientation", WXYZ),
)


def _imu(message: Any, topic: str) -> Decoded:  # noqa: ANN401
    readings = []
    for name, unit, attribute, axes in IMU_FIELDS:
        covariance = getattr(message, f"{attribute}_covariance", None)
        # By the message's definition -1 says that the sensor does not give this quantity.
        if covariance is not None and len(covariance) and covariance[0] == -1:
            continue
        value = getattr(message, attribute)
        readings.append(Reading(name, unit, axes, [getattr(value, axis) for axis in axes]))
    return Decoded(stamp_of(message), readings)


def _battery(message: Any, topic: str) -> Decoded:  # noqa: ANN401
    return Decoded(stamp_of(message), [Reading("supply_voltage", "V", ("battery",), [message.voltage])])


EXTRACTORS: Mapping[str, Extract] = {
    "sensor_msgs/JointState": _joint_state,
    "control_msgs/DynamicJointState": _dynamic_joint_state,
    "sensor_msgs/Imu": _imu,
    "sensor_msgs/BatteryState": _battery,
    "bitbots_msgs/JointCommand": _joint_command,
    "control_msgs/JointTrajectoryControllerState": _controller_state,
    "trajectory_msgs/JointTrajectory": _joint_trajectory,
    "std_msgs/Float64MultiArray": _multi_array,
    "foxglove.JointStates": _foxglove_joint_states,
}
