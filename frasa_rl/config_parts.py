"""What a task is made of beside its numbers: moved joints, names in the model, physics settings, reward weights."""

from dataclasses import dataclass, fields
from typing import Literal

from frasa_rl.config_checks import TaskError, name_of, one_of, pattern, within


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
        islands: whether the solver takes bodies that do not touch apart; one robot alone is one island anyway.
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
    islands: bool | None = None
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
    """Weights and slopes of the terms; all are positive, so ending early only loses.

    Attributes:
        posture: weight of being near the standing pose.
        action: weight of small rates.
        variation: weight of steady rates.
        self_contact: weight of parts not touching each other.
        gathering: weight of the centre of mass above flat feet, whatever the joints do; not in the paper.
        approach: weight of the standing pose from further away, once the trunk is high and upright; not in the paper.
        posture_slope: slope of the posture term [1/rad^2].
        approach_slope: smallest slope of the approach term, the others are 4 and 32 times as large [1/rad^2].
        action_slope: slope of the action and variation terms [s/rad].
        contact_slope: slope of the self-contact term [1/N].
    """

    posture: float = 1.0
    action: float = 0.10  # in the published environment, absent from the paper
    variation: float = 0.05
    self_contact: float = 0.10
    gathering: float = 0.0
    approach: float = 0.0
    posture_slope: float = 20.0
    approach_slope: float = 2.0
    action_slope: float = 1.0
    contact_slope: float = 1.0

    def __post_init__(self) -> None:
        for one in fields(self):
            within(one.name, getattr(self, one.name), 0.0, 1e4)
        if self.posture == 0.0:
            raise TaskError("posture is 0: expected a weight above zero, or nothing rewards standing")
