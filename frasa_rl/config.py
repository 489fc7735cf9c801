"""What the stand-up task is, in one place: poses, rates, rewards, ends, and the ranges nobody has measured.

Measured ranges are not here: they come with the calibrated model (`frasa_sysid.calibration`). Numbers and names that
cannot be are refused when a task is made (`TaskError`); what the model must have is checked by `find_robot`. Files that
hold a task are read and written by `task_file`, whose comments are the attributes' descriptions here and in the parts.
"""

from dataclasses import dataclass, field
from math import pi
from typing import Literal

from frasa_rl.assumed import Assumed, AssumedRanges, ServoSpread
from frasa_rl.config_checks import TaskError, above, name_of, one_of, within
from frasa_rl.config_parts import Joint, Names, Physics, Reward
from frasa_rl.config_rig import PushRig

__all__ = [
    "Assumed", "AssumedRanges", "Joint", "Names", "Physics", "PushRig", "Reward", "ServoSpread", "Task", "TaskError",
]  # fmt: skip

PAPER = "FRASA, Gaspard et al., arXiv 2410.08655"


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
        near_target_push: and of the speed that a push at the trunk gives its centre of mass, forward or back [m/s].
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
        rig: the pendulum that pushes the standing robot in an evaluation.
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
    near_target_push: float = 0.0
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
    rig: PushRig = field(default_factory=PushRig)

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
    "near_target_push": (0.0, 10.0, "m/s"),
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
