"""The contract between fitting and training: parameters, ranges, loading, applying.

    FitResult -> Calibration -> calibrated.xml + randomization.yaml -> StandUp

Imports numpy, mujoco and yaml only, so that a policy can be trained without the fitter. `page` and `figures`, the look
of all pages that both packages leave, stand here too, for nothing else is known to both.
"""

from frasa_sysid.calibration.apply import (
    actuators_of,
    apply,
    assign,
    delay_room,
    delayed_sensors,
    dofs_of,
    number,
    read,
    servo_classes,
    trunk_of,
)
from frasa_sysid.calibration.bounded_read import read_limited
from frasa_sysid.calibration.cluster import dask_client
from frasa_sysid.calibration.command_line import (
    add_json_flag,
    add_report_arguments,
    plain,
    run_command,
    say,
    tell_report,
)
from frasa_sysid.calibration.errors import (
    BusyError,
    CalibrationError,
    FrasaError,
    InputError,
    InterruptedRunError,
    ModelError,
    OutputError,
    QualityError,
    UsageError,
)
from frasa_sysid.calibration.files import cannot_write, sha256_of, sha256_of_file, write_atomic, write_together
from frasa_sysid.calibration.history import hold_history
from frasa_sysid.calibration.load import (
    calibration_id,
    compile_model,
    load_calibration,
    load_model,
    load_spec,
    read_calibration,
)
from frasa_sysid.calibration.locks import alone
from frasa_sysid.calibration.parameters import (
    JOINT_FIELDS,
    LAW_FIELDS,
    SENSOR_FIELDS,
    SERVO_FIELDS,
    TRUNK_FIELDS,
    Parameter,
    parameter,
)
from frasa_sysid.calibration.plain_yaml import read_yaml
from frasa_sysid.calibration.provenance import input_hashes, model_sha256, versions
from frasa_sysid.calibration.ranges import Calibration, Range

__all__ = [
    "JOINT_FIELDS",
    "LAW_FIELDS",
    "SENSOR_FIELDS",
    "SERVO_FIELDS",
    "TRUNK_FIELDS",
    "BusyError",
    "Calibration",
    "CalibrationError",
    "FrasaError",
    "InputError",
    "InterruptedRunError",
    "ModelError",
    "OutputError",
    "Parameter",
    "QualityError",
    "Range",
    "UsageError",
    "actuators_of",
    "add_json_flag",
    "add_report_arguments",
    "alone",
    "apply",
    "assign",
    "calibration_id",
    "cannot_write",
    "compile_model",
    "dask_client",
    "delay_room",
    "delayed_sensors",
    "dofs_of",
    "hold_history",
    "input_hashes",
    "load_calibration",
    "load_model",
    "load_spec",
    "model_sha256",
    "number",
    "parameter",
    "plain",
    "read",
    "read_calibration",
    "read_limited",
    "read_yaml",
    "run_command",
    "say",
    "servo_classes",
    "sha256_of",
    "sha256_of_file",
    "tell_report",
    "trunk_of",
    "versions",
    "write_atomic",
    "write_together",
]
