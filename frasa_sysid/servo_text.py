"""Servo tables as text: an empty one to fill in, and the file of one that comes with frasa to start from."""

import re
from importlib import resources

from frasa_sysid.errors import UsageError
from frasa_sysid.servo import FOLDER, TABLES
from frasa_sysid.servo_table import NAME, RESERVED

_EMPTY = """\
# A servo of your own. Fill in what is 0 or ..., from its data sheet; then see what it comes to:
#     frasa-sysid servos {name}.toml
# Every number has a unit. low and high, where you know bounds, keep the fit between them.
schema = "frasa.servo/1"
name = "{name}"                       # what logs and models call it
title = "{name}"
source = "..."                        # of all numbers that name no other

[firmware]                            # duty = error_gain * P * error, at most max_duty
position_gain = 0                     # P at which the model's numbers are stated, in the firmware's own unit
# How much duty (share of the full PWM) an error makes. Either as a number,
error_gain = {{ value = 0, unit = "1/rad" }}        # duty per rad and unit of P; or 1/deg
# or as manuals say it: duty = P * error [ticks] / gain_divisor / full_duty (gain_shift = 8 is a divisor of 256)
# gain_divisor = 256
# full_duty = 885
max_duty = 1.0                        # what the firmware limits the duty to
ticks_per_turn = 4096
supply_compensated = false            # true where the firmware makes up for the supply's voltage

[supply]
voltage = {{ value = 0, unit = "V" }}   # at which the model's numbers are stated

[motor]                               # at the output, at that voltage; or kt [N m/A] and resistance [Ohm]
stall_torque = {{ value = 0, unit = "N m" }}        # N m, mN m, kg cm, oz in
no_load_speed = {{ value = 0, unit = "rad/s" }}     # rad/s, deg/s, rpm, s/60deg

# [joint]                             # where the search starts; left out, they are guessed from the motor's
# armature = {{ value = 0.01, unit = "kg m^2", low = 0.001, high = 0.1 }}
# viscous = {{ value = 0.02, unit = "N m s/rad" }}
# coulomb = {{ value = 0.05, unit = "N m" }}
"""


def new_table(name: str, like: str | None = None) -> str:
    """A table to fill in.

    Args:
        name: of the new servo.
        like: a servo that comes with frasa, whose numbers to start from; by default none.

    Raises:
        UsageError: not a name, or an unknown servo.
    """
    if not NAME.fullmatch(name) or name in RESERVED:
        raise UsageError(f"--new {name}: expected lower-case letters, digits and underscores, such as mx28")
    if like is None:
        return _EMPTY.format(name=name)
    if like not in TABLES:
        raise UsageError(f"--like {like}: known are {', '.join(sorted(TABLES))}")
    text = (resources.files("frasa_sysid") / FOLDER / f"{like}.toml").read_text(encoding="utf-8")
    text = re.sub(r'(?m)^name = ".*"$', f'name = "{name}"', text, count=1)
    text = re.sub(r'(?m)^title = ".*"$', f'title = "{name}"', text, count=1)
    # What somebody identified on another servo is no truth of this one.
    text = text.partition("\n[simulated]")[0]
    return f"# Started from {like}'s numbers: change what differs, and say where it is from.\n{text.rstrip()}\n"
