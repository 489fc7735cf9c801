"""What the stand-up task is, in one place: poses, rates, rewards, ends, and the ranges nobody has measured.

Measured ranges are not here: they come with the calibrated model (`frasa_sysid.calibration`). Numbers and names that
cannot be are refused when a task is made (`TaskError`); what the model must have is checked by `find_robot`. Files that
hold a task are read and written by `task_file`, whose comments are the attributes' descriptions here.
"""

from dataclasses import dataclass, field
from math import pi
from typing import Literal

from frasa_rl.assumed import Assumed, AssumedRanges, ServoSpread
from frasa_rl.config_checks import TaskError, above, name_of, one_of, pattern, within

__all__ = ["Assumed", "AssumedRanges", "Joint", "Names", "Physics", "Reward", "ServoSpread", "Task", "TaskError"]

PAPER = "FRASA, Gaspard et al., arXiv 2410.08655"


@dataclass(frozen=True)
class Joint:
    """A joint the policy moves on both sides at once.

    Attributes:
        name: without the side; `names` makes the model's names of it.
        target_deg: angle of the standing pose, of the left side [deg].
        mirror: 1 when the same number on both sides is the symmetric pose, else -1.
        left: the model's own name of the left joint, where `names` would make another; null for that one.
        right: the same of the right joint; that of the left one for a joint on the midline.
    """

    name: str
    target_deg: float
    mirror: int = 1
    left: str | None = None
    right: str | None = None

    def __post_init__(self) -> None:
        for name in ("name", "left", "right"):
            name_of(name, getattr(self, name))
        within(f"target_deg of {self.name}", self.target_deg, -180.0, 180.0, "deg")
        one_of(f"mirror of {self.name}", self.mirror, (1, -1))


@dataclass(frozen=True)
class Names:
    """What the task's things are called in the model; braces stand for the joint's name.

    Attributes:
        trunk: body with the free joint; its axes are x forward, y left, z up.
        floor: geom the robot lies and stands on.
        left: joint on the left, from the name of a moved joint.
        right: joint on the right.
        position: sensor, from the model's name of a joint; null reads the truth, undelayed.
        velocity: sensor, from the model's name of a joint; null reads the truth, undelayed.
        orientation: sensor of the trunk's orientation, with its delay; null reads the truth.
        gyro: sensor of the trunk's angular rate, with its delay; null reads the truth.
        self_contact: sensor of contact forces between parts of the robot; null has one added to the model.
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

    def __post_init__(self) -> None:
        for name in ("left", "right", "position", "velocity"):
            pattern(name, getattr(self, name))
        for name in ("trunk", "floor", "orientation", "gyro", "self_contact"):
            name_of(name, getattr(self, name))

    def pair(self, joint: Joint) -> tuple[str, str]:
        """What the model calls a moved joint, left and right."""
        return joint.left or self.left.format(joint.name), joint.right or self.right.format(joint.name)


@dataclass(frozen=True)
class Physics:
    """How MuJoCo steps; null leaves what the model file says.

    Attributes:
        timestep: must divide the control period [s].
        integrator: `euler`, `implicit`, `implicitfast` or `rk4`.
        cone: of friction, `pyramidal` or `elliptic`.
        iterations: most solver iterations a step.
        tolerance: of the solver.
        noslip_iterations: of the pass against creeping contacts.
        self_collision: whether parts of the robot collide with each other.
        friction_law: `model` has the servos' friction laws M2 to M6 where the model carries them; `coulomb_viscous`
            puts constant dry friction in their place (`friction_stand_in`).
    """

    timestep: float | None = None
    integrator: Literal["euler", "implicit", "implicitfast", "rk4"] | None = None
    cone: Literal["pyramidal", "elliptic"] | None = None
    iterations: int | None = None
    tolerance: float | None = None
    noslip_iterations: int | None = None
    self_collision: bool | None = None
    friction_law: Literal["model", "coulomb_viscous"] = "model"

    def __post_init__(self) -> None:
        within("timestep", self.timestep, 1e-5, 1.0, "s")
        one_of("integrator", self.integrator, (None, "euler", "implicit", "implicitfast", "rk4"))
        one_of("cone", self.cone, (None, "pyramidal", "elliptic"))
        within("iterations", self.iterations, 1, 10_000)
        within("tolerance", self.tolerance, 0.0, 1.0)
        within("noslip_iterations", self.noslip_iterations, 0, 10_000)
        one_of("friction_law", self.friction_law, ("model", "coulomb_viscous"))


@dataclass(frozen=True)
class Reward:
    """Weights and slopes of the four terms; all are positive, so ending early only loses.

    Attributes:
        posture: weight of being near the standing pose.
        action: weight of small rates.
        variation: weight of steady rates.
        self_contact: weight of parts not touching each other.
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

    def __post_init__(self) -> None:
        for name in ("posture", "action", "variation", "self_contact", "posture_slope", "action_slope"):
            within(name, getattr(self, name), 0.0, 1e4)
        within("contact_slope", self.contact_slope, 0.0, 1e4)
        if self.posture == 0.0:
            raise TaskError("posture is 0: expected a weight above zero, or nothing rewards standing")


@dataclass(frozen=True)
class Task:
    """The stand-up task.

    Attributes:
        compat: empty; `frasa2024` behaves as FRASA's published environment does, its errors included (`compat2024`).
        joints: what the policy moves, in the order of actions and observations: `name` without the side, `target_deg`
            of the left side in the standing pose, `mirror` -1 where the right side needs the opposite number; `left`
            and `right`, where `names` would not make the model's names of it.
        target_pitch_deg: trunk pitch of the standing pose, forward positive [deg].
        held_deg: fixed commands of other actuators, by name [deg]; those not named hold 0.
        control_period_s: time between two actions [s].
        rate_limit: joint rate that action 1 stands for [rad/s].
        episode_s: an episode is truncated after it [s].
        end_pitch_deg: an episode ends beyond this trunk pitch, either way [deg].
        end_gyro: and beyond this pitch rate [rad/s].
        near_target_share: share of the starts that are near the standing pose (p_s of the paper).
        near_target_spread: half-width of the joint offsets of such a start [rad].
        falling_share: share of the starts somewhere between the standing pose and a random one, still falling.
        falling_s: how long such a robot has been falling [s]; longer than any delay.
        start_pitch_deg: half-width of the trunk pitch of all other starts [deg].
        release_height: gap between the lowest point and the floor at release [m].
        settle_max_s: longest time a fall may take to come to rest [s].
        still_s: at rest means slow for so long [s].
        still_speed: slow means all speeds below this [rad/s, m/s].
        success_deg: standing means the errors of all joints and of the pitch below this [deg].
        success_hold_s: for so long [s].
        nominal_voltage: supply at which gains and torque limits of the model hold [V]; null reads the model's custom
            number `servo_supply_voltage`. Without either, an assumed range in volts is not drawn.
        reward: weights and slopes.
        assumed: ranges that were not measured.
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
    nominal_voltage: float | None = None
    reward: Reward = field(default_factory=Reward)
    assumed: AssumedRanges = field(default_factory=AssumedRanges)
    names: Names = field(default_factory=Names)
    physics: Physics = field(default_factory=Physics)

    def __post_init__(self) -> None:
        one_of("compat", self.compat, ("", "frasa2024"))
        self._check_joints()
        for name, (low, high, unit) in _BOUNDS.items():
            within(name, getattr(self, name), low, high, unit)
        for name, (low, high, unit) in _ABOVE.items():
            above(name, getattr(self, name), low, high, unit)
        self._check_together()

    def _check_joints(self) -> None:
        if not self.joints:
            raise TaskError("joints is empty: expected at least one joint to move")
        pairs = [self.names.pair(one) for one in self.joints]
        for one, (left, right) in zip(self.joints, pairs, strict=True):
            if left == right and one.mirror != 1:
                raise TaskError(f"{one.name} is {left} on both sides with mirror {one.mirror}: expected mirror 1")
        moved = [name for pair in pairs for name in dict.fromkeys(pair)]
        for kind, names in (("joints", moved), ("held_deg", [name for name, _ in self.held_deg])):
            twice = sorted({name for name in names if names.count(name) > 1})
            if twice:
                raise TaskError(f"{kind} has {', '.join(twice)} twice: expected each once")
        for name, angle in self.held_deg:
            name_of("a name in held_deg", name)
            within(f"held_deg of {name}", angle, -180.0, 180.0, "deg")

    def _check_together(self) -> None:
        """Numbers that contradict each other."""
        shares = self.near_target_share + self.falling_share
        if shares > 1.0 + 1e-9:
            raise TaskError(f"near_target_share and falling_share are {shares:g} together: expected at most 1")
        for small, large in _ORDER:
            if getattr(self, small) > getattr(self, large) + 1e-9:
                raise TaskError(
                    f"{small} is {getattr(self, small):g} and {large} is {getattr(self, large):g}: "
                    f"expected {small} not to be larger"
                )
        if abs(self.target_pitch_deg) >= self.end_pitch_deg:
            raise TaskError(
                f"target_pitch_deg is {self.target_pitch_deg:g} and end_pitch_deg is {self.end_pitch_deg:g}: "
                "expected a standing pose that does not end the episode"
            )


_BOUNDS = {
    "target_pitch_deg": (-90.0, 90.0, "deg"),
    "end_gyro": (0.0, 1e3, "rad/s"),
    "near_target_share": (0.0, 1.0, ""),
    "near_target_spread": (0.0, pi, "rad"),
    "falling_share": (0.0, 1.0, ""),
    "start_pitch_deg": (0.0, 180.0, "deg"),
    "release_height": (0.0, 1.0, "m"),
    "success_hold_s": (0.0, 600.0, "s"),
}
_ABOVE = {
    "control_period_s": (0.0, 1.0, "s"),
    "rate_limit": (0.0, 100.0, "rad/s"),
    "episode_s": (0.0, 3600.0, "s"),
    "end_pitch_deg": (0.0, 180.0, "deg"),
    "falling_s": (0.0, 60.0, "s"),
    "settle_max_s": (0.0, 60.0, "s"),
    "still_s": (0.0, 60.0, "s"),
    "still_speed": (0.0, 100.0, "rad/s"),
    "success_deg": (0.0, 90.0, "deg"),
    "nominal_voltage": (0.0, 1e3, "V"),
}
_ORDER = (
    ("control_period_s", "episode_s"),
    ("still_s", "settle_max_s"),
)
