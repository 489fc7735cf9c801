"""Message definitions of bags that hold none: field lists of the public interfaces, as far as frasa reads them.

Fields that newer versions append are left alone by the decoder, so that the oldest list serves.
"""

from frasa_sysid.message_definitions import HEADER, TIME

_POINT = """
================================================================================
MSG: trajectory_msgs/JointTrajectoryPoint
float64[] positions
float64[] velocities
float64[] accelerations
float64[] effort
builtin_interfaces/Duration time_from_start

================================================================================
MSG: builtin_interfaces/Duration
int32 sec
uint32 nanosec
"""

_STATE = """std_msgs/Header header
string[] joint_names
trajectory_msgs/JointTrajectoryPoint desired
trajectory_msgs/JointTrajectoryPoint actual
trajectory_msgs/JointTrajectoryPoint error
"""

_COMMAND = """std_msgs/Header header
string[] joint_names
float64[] positions
float64[] velocities
float64[] accelerations
"""

LEGACY = {
    "control_msgs/msg/JointTrajectoryControllerState": f"{_STATE}{_POINT}{HEADER}{TIME}",
    "bitbots_msgs/msg/JointCommand": f"{_COMMAND}{HEADER}{TIME}",
}
