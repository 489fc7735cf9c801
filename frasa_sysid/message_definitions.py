"""The ROS 2 message definitions that frasa writes, as text, so that no ROS is needed.

Field lists of the public interfaces; a definition is followed by those it uses.
"""

SIMULATED = "/sim/"  # topics of simulated traces begin so; what stands on them is never taken for a measurement

TIME = """
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""

HEADER = """
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
"""

JOINT_STATE = f"""std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
{HEADER}{TIME}"""

DYNAMIC_JOINT_STATE = f"""std_msgs/Header header
string[] joint_names
control_msgs/InterfaceValue[] interface_values

================================================================================
MSG: control_msgs/InterfaceValue
string[] interface_names
float64[] values
{HEADER}{TIME}"""

IMU = f"""std_msgs/Header header
geometry_msgs/Quaternion orientation
float64[9] orientation_covariance
geometry_msgs/Vector3 angular_velocity
float64[9] angular_velocity_covariance
geometry_msgs/Vector3 linear_acceleration
float64[9] linear_acceleration_covariance

================================================================================
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w

================================================================================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
{HEADER}{TIME}"""

BATTERY_STATE = f"""std_msgs/Header header
float32 voltage
float32 temperature
float32 current
float32 charge
float32 capacity
float32 design_capacity
float32 percentage
uint8 power_supply_status
uint8 power_supply_health
uint8 power_supply_technology
bool present
float32[] cell_voltage
float32[] cell_temperature
string location
string serial_number
{HEADER}{TIME}"""

DEFINITIONS = {
    "sensor_msgs/msg/JointState": JOINT_STATE,
    "control_msgs/msg/DynamicJointState": DYNAMIC_JOINT_STATE,
    "sensor_msgs/msg/Imu": IMU,
    "sensor_msgs/msg/BatteryState": BATTERY_STATE,
}
