"""A pendulum bench of any servo as MuJoCo models: what its fit is published into while there is no robot.

`bench_model(servo, fitting=False)` is a nominal model like a robot's, with the servo as its one class;
with `fitting` it is the bench that fits step, to second order (`calibration.stepping`).
"""

from frasa_sysid.calibration.stepping import HARD, HARD_STEPS
from frasa_sysid.servo_type import Servo

TIMESTEP = 0.002  # [s] as the Sigmaban's
_ROOM = 16  # steps of command history: 32 ms

_XML = """<mujoco model="{model}">
  <!-- {title}
  Angle 0 hangs straight down; gravity's torque is -m g l sin(q). The mass is an example: a fit takes that of each log.
  Numbers of the servo: {source} -->
  <compiler angle="radian" autolimits="true"/>
  <option timestep="{step!r}" integrator="Euler" solver="Newton" cone="pyramidal" iterations="100" tolerance="1e-8"
          noslip_iterations="1" noslip_tolerance="1e-6" impratio="1" gravity="0 0 -9.81">{flag}</option>
  <default>
    <default class="{name}">
      <joint damping="{damping!r}" armature="{armature!r}" frictionloss="{friction!r}"{hard}/>
      <position kp="{kp!r}" forcerange="-{force!r} {force!r}" delay="0" nsample="{room}" interp="linear"/>
    </default>
  </default>
  <visual>
    <headlight diffuse="0.5 0.5 0.5" ambient="0.35 0.35 0.35"/>
  </visual>
  <worldbody>
    <light pos="0.3 -1 1" dir="-0.3 1 -1" type="directional" diffuse="0.5 0.5 0.5"/>
    <geom name="stand" type="box" pos="0 0.045 0" size="0.03 0.03 0.03" contype="0" conaffinity="0"/>
    <body name="pendulum">
      <joint name="servo" class="{name}" axis="0 -1 0"/>
      <inertial pos="0 0 -{length!r}" mass="{mass!r}" diaginertia="1e-9 1e-9 1e-9"/>
      <geom name="arm" type="capsule" fromto="0 0 0 0 0 -{length!r}" size="0.004" contype="0" conaffinity="0"/>
      <geom name="weight" type="sphere" pos="0 0 -{length!r}" size="0.02" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
  <actuator>
    <position name="servo" joint="servo" class="{name}"/>
  </actuator>
  <custom>
    <numeric name="servo_supply_voltage" data="{supply!r}"/>
    <numeric name="servo_firmware_gain" data="{gain!r}"/>
    <tuple name="{name}">
      <element objtype="actuator" objname="servo"/>
    </tuple>
  </custom>
</mujoco>
"""


def bench_model(servo: Servo, mass: float, length: float, fitting: bool = False, timestep: float = TIMESTEP) -> str:
    """XML of a bench.

    Args:
        servo: its one class.
        mass: of the example's load [kg].
        length: of its arm [m].
        fitting: steps damping and friction to second order.
        timestep: [s].
    """
    hard = " ".join(repr(one) for one in HARD)
    armature = servo.armature + (0.5 * timestep * servo.damping() if fitting else 0.0)
    return _XML.format(
        model="bench_pendulum" if fitting else f"{servo.name}_bench",
        title="The bench that fits are made on." if fitting else "One servo on a bench, before any calibration.",
        source=servo.source.replace("--", "-"),
        flag='<flag eulerdamp="disable"/>' if fitting else "",
        hard=f' solreffriction="{HARD_STEPS * timestep!r} 1" solimpfriction="{hard}"' if fitting else "",
        step=timestep,
        name=servo.name,
        damping=servo.damping(),
        armature=armature,
        friction=servo.friction.coulomb,
        kp=servo.kp(),
        force=servo.force_limit(),
        room=_ROOM,
        length=length,
        mass=mass,
        supply=servo.supply_voltage,
        gain=servo.firmware_gain,
    )
