"""What the stand-up task is, in one place: poses, rates, rewards, ends, and the ranges nobody has measured.

Measured ranges are not here: they come with the calibrated model (`frasa_sysid.calibration`).
"""

from dataclasses import dataclass, field
from math import pi, radians
from typing import Literal

PAPER = "FRASA, Gaspard et al., arXiv 2410.08655"
ENVIRONMENT = "FRASA's published environment, Rhoban/frasa at 78457df"


@dataclass(frozen=True)
class Joint:
    """A joint the policy moves on both sides at once.

    Attributes:
        name: without the side; the model has `left_<name>` and `right_<name>`.
        target_deg: angle of the standing pose [deg].
        mirror: +1 when the same number on both sides is the symmetric pose, else -1.
    """

    name: str
    target_deg: float
    mirror: int = 1


@dataclass(frozen=True)
class Names:
    """What the task's things are called in the model; braces stand for the joint's name.

    Attributes:
        trunk: body with the free joint; its axes are x forward, y left, z up.
        floor: geom the robot lies and stands on.
        left, right: joints, from the name of a `Joint`; both may be the same for a joint on the midline.
        position, velocity: sensors, from the full name of a joint; None reads the truth, undelayed.
        orientation, gyro: of the trunk, delayed as the robot reads them; None reads the truth.
        self_contact: contact forces between parts of the robot; None has one added to the model.
    """

    trunk: str = "trunk"
    floor: str = "floor"
    left: str = "left_{}"
    right: str = "right_{}"
    position: str | None = "{}.position"
    velocity: str | None = "{}.velocity"
    orientation: str | None = "measured_orientation"
    gyro: str | None = "measured_gyro"
    self_contact: str | None = "self_contact"


@dataclass(frozen=True)
class Physics:
    """How MuJoCo steps; None leaves what the model file says.

    Attributes:
        timestep: [s]; must divide the control period.
        integrator: of `mjtIntegrator`.
        cone: of friction.
        iterations: most solver iterations a step.
        tolerance: of the solver.
        noslip_iterations: of the pass against creeping contacts.
        self_collision: whether parts of the robot collide with each other.
    """

    timestep: float | None = None
    integrator: Literal["euler", "implicit", "implicitfast", "rk4"] | None = None
    cone: Literal["pyramidal", "elliptic"] | None = None
    iterations: int | None = None
    tolerance: float | None = None
    noslip_iterations: int | None = None
    self_collision: bool | None = None


@dataclass(frozen=True)
class Reward:
    """Weights and slopes of the four terms; all are positive, so ending early only loses.

    Attributes:
        posture, action, variation, self_contact: weight of each term.
        posture_slope: slope of the posture term [1/rad^2].
        action_slope: slope of the action and variation terms [s/rad].
        contact_slope: slope of the self-contact term [1/N].
    """

    posture: float = 1.0
    action: float = 0.10  # in the published environment, absent from the paper
    variation: float = 0.05
    self_contact: float = 0.10
    posture_slope: float = 20.0
    action_slope: float = 1.0
    contact_slope: float = 1.0


@dataclass(frozen=True)
class Assumed:
    """A range that was not measured on the robot.

    Attributes:
        low, high: uniform between them.
        unit: SI unit, or `ratio` when the model's own value is multiplied.
        source: who assumed it.
    """

    low: float
    high: float
    unit: str
    source: str


@dataclass(frozen=True)
class AssumedRanges:
    """What differs from episode to episode beside the calibrated ranges.

    A measured range replaces the assumed one: of the trunk's mass, each coordinate of its centre of mass, the
    supply, each joint's zero, and damping and friction loss of each servo class.
    """

    floor_friction: Assumed = Assumed(0.25, 1.5, "1", ENVIRONMENT)
    trunk_mass: Assumed = Assumed(0.8, 1.2, "ratio", ENVIRONMENT)
    trunk_com: Assumed = Assumed(-0.005, 0.005, "m", ENVIRONMENT)
    supply_voltage: Assumed = Assumed(13.8, 16.8, "V", f"{ENVIRONMENT}: a 4-cell battery, empty to full")
    joint_zero: Assumed = Assumed(radians(-1.5), radians(1.5), "rad", ENVIRONMENT)
    damping: Assumed = Assumed(0.8, 1.2, "ratio", ENVIRONMENT)
    frictionloss: Assumed = Assumed(0.8, 1.2, "ratio", ENVIRONMENT)


@dataclass(frozen=True)
class Task:
    """The stand-up task.

    Attributes:
        compat: `frasa2024` behaves as FRASA's published environment does, its errors included (`compat2024`).
        joints: what the policy moves, in the order of actions and observations.
        target_pitch_deg: trunk pitch of the standing pose, forward positive [deg].
        held_deg: fixed commands of other actuators [deg]; those not named hold 0.
        control_period_s: time between two actions [s].
        rate_limit: joint rate that action 1 stands for [rad/s].
        episode_s: an episode is truncated after it [s].
        end_pitch_deg, end_gyro: an episode ends beyond these [deg], [rad/s].
        near_target_share: share of the starts that are near the standing pose (p_s of the paper).
        near_target_spread: half-width of the joint offsets of such a start [rad].
        falling_share: share of the starts somewhere between the standing pose and a random one, still falling.
        falling_s: how long such a robot has been falling [s]; longer than any delay.
        start_pitch_deg: half-width of the trunk pitch of all other starts [deg].
        release_height: gap between the lowest point and the floor at release [m].
        settle_max_s: longest time a fall may take to come to rest [s].
        still_s, still_speed: at rest means all speeds below `still_speed` [rad/s, m/s] for `still_s` [s].
        success_deg, success_hold_s: standing means all six errors below this, for so long [deg], [s].
        names: what all these things are called in the model.
        physics: how MuJoCo steps.
    """

    compat: Literal["", "frasa2024"] = ""
    joints: tuple[Joint, ...] = (
        Joint("elbow", -49.5),
        Joint("shoulder_pitch", 19.5),
        Joint("hip_pitch", -52.0),
        Joint("knee", 79.0),
        Joint("ankle_pitch", -36.5),
    )
    target_pitch_deg: float = 8.5
    held_deg: tuple[tuple[str, float], ...] = (("left_shoulder_roll", -5.0), ("right_shoulder_roll", 5.0))
    control_period_s: float = 0.05
    rate_limit: float = 2.0 * pi
    episode_s: float = 5.0
    end_pitch_deg: float = 135.0
    end_gyro: float = 5.0
    near_target_share: float = 0.10
    near_target_spread: float = 0.10
    falling_share: float = 0.0
    falling_s: float = 0.10
    start_pitch_deg: float = 90.0
    release_height: float = 0.01
    settle_max_s: float = 2.0
    still_s: float = 0.2
    still_speed: float = 0.05
    success_deg: float = 5.0
    success_hold_s: float = 0.5
    reward: Reward = field(default_factory=Reward)
    assumed: AssumedRanges = field(default_factory=AssumedRanges)
    names: Names = field(default_factory=Names)
    physics: Physics = field(default_factory=Physics)
