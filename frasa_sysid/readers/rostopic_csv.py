"""`rostopic echo -p` of a ROS 1 topic (sensor_msgs/Imu or JointState), CSV -> recording.

`%time` is when the message was received, `field.header.stamp` when it was made, both ns since 1970. The stamps are
used; how long messages took to arrive is compared and reported. Such a file was kept of a Spirit 40 by
robomechanics/quad-sdk (history of 50b58ce, `EKF_tests_2021_12_3/test2.csv`, MIT).
"""

from pathlib import Path

import numpy as np

from frasa_sysid.clocks import compare_clocks
from frasa_sysid.errors import LogError
from frasa_sysid.readers.parts import Part, assemble
from frasa_sysid.readers.sampling import plural
from frasa_sysid.readers.tables import Table, read_table
from frasa_sysid.recording import Fault, FloatArray, Recording, RigFacts

RECEIVED, STAMP = "%time", "field.header.stamp"
LATE = 0.1  # s; a message that arrives later than this was waiting somewhere
FIELDS = (
    ("gyro", "rad/s", "field.angular_velocity", ("x", "y", "z")),
    ("acceleration", "m/s^2", "field.linear_acceleration", ("x", "y", "z")),
    ("orientation", "1", "field.orientation", ("w", "x", "y", "z")),
)
JOINTS = (("position", "rad"), ("velocity", "rad/s"), ("effort", "raw"))


def read_rostopic_csv(path: Path) -> list[Recording]:
    """The one recording of such a file.

    Raises:
        LogError: not such a file, or of a message type that is not known.
    """
    table = read_table(path, (RECEIVED, STAMP), everything=True)
    stamps, received = table.integers(STAMP), table.integers(RECEIVED)
    start = int(stamps.min())
    t, arrived = (stamps - start) / 1e9, (received - start) / 1e9
    parts = [*_imu(table, t), *_joint_state(table, t)]
    if not parts:
        raise LogError(
            f"{path}: expected columns of sensor_msgs/Imu or JointState, found {', '.join(table.names)[:120]}"
        )
    clocks = compare_clocks("received", arrived, "stamp", t)
    found = []
    late = int((arrived - t > LATE).sum())
    if late:
        text = (
            f"{plural(late, 'message')} arrived more than {LATE:g} s after their stamps, up to "
            f"{(arrived - t).max():.2f} s (median {1e3 * np.median(arrived - t):.1f} ms): a backlog; the stamps count"
        )
        found.append(Fault("backlog", late, text))
    return [assemble(path, parts, RigFacts(), found, {"clocks": [clocks] if clocks else []})]


def _imu(table: Table, t: FloatArray) -> list[Part]:
    parts = []
    for name, unit, field, axes in FIELDS:
        columns = [f"{field}.{axis}" for axis in axes]
        absent = f"{field}_covariance0"
        # By the message's definition a covariance of -1 marks what the sensor does not give.
        if absent in table.names and (table.numbers(absent) == -1).all():
            continue
        if all(one in table.names for one in columns):
            parts.append(Part(name, unit, t, np.stack([table.numbers(one) for one in columns], axis=1), axes))
    return parts


def _joint_state(table: Table, t: FloatArray) -> list[Part]:
    joints: list[str] = []
    while f"field.name{len(joints)}" in table.names:
        joints.append(table.text(f"field.name{len(joints)}")[0])
    parts = []
    for name, unit in JOINTS:
        columns = [f"field.{name}{i}" for i in range(len(joints))]
        if joints and all(one in table.names for one in columns):
            y = np.stack([table.numbers(one) for one in columns], axis=1)
            parts.append(Part(name, unit, t, y, tuple(joints)))
    return parts
