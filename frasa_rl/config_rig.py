"""The pendulum of the push trials, and how hard it hits."""

from dataclasses import dataclass
from math import acos

from frasa_rl.config_checks import TaskError, above, within
from frasa_sysid.calibration import UsageError


@dataclass(frozen=True)
class PushRig:
    """The pendulum that pushes the standing robot.

    Of the assumed numbers the contact's time constant hardly matters (5 to 20 ms: the Sigmaban's impulse changes by
    5 %); a smaller ball or a rougher one gives a front push up to 20 % more impulse.

    Attributes:
        mass: of the bob [kg]; the rod has none (the paper).
        length: from the hinge to the bob's centre [m] (the paper; taken to mean the centre).
        height: of the hinge above the floor [m] (the paper); less the length, it is where the bob hits.
        radius: of the bob, a ball [m]; assumed: 0.9 kg would be heavier than water and lighter than stone.
        contact_s: time constant of its contact, critically damped, so that it hardly rebounds [s]; assumed.
        friction: of the bob on the robot; assumed.
        retrieve_s: time constant of the motor that pulls it back [s]; assumed.
        gravity: must be the model's [m/s^2].
        energies_j: of the pushes, each from front and back, weakest first [J] (the paper).
    """

    mass: float = 0.9
    length: float = 1.28
    height: float = 1.74
    radius: float = 0.05
    contact_s: float = 0.01
    friction: float = 0.5
    retrieve_s: float = 0.2
    gravity: float = 9.81
    energies_j: tuple[float, ...] = (4.0, 5.5, 7.3)

    def __post_init__(self) -> None:
        for name, (high, unit) in _ABOVE.items():
            above(name, getattr(self, name), 0.0, high, unit)
        within("friction", self.friction, 0.0, 10.0)
        if self.height < self.length + self.radius:
            raise TaskError(
                f"height is {self.height:g} and length {self.length:g}, radius {self.radius:g}: "
                "expected a bob that hangs above the floor"
            )
        if not self.energies_j or list(self.energies_j) != sorted(set(self.energies_j)):
            raise TaskError("energies_j: expected at least one number, each larger than the one before")
        for energy in self.energies_j:
            above("a number of energies_j", energy, 0.0, self.most_j, "J, what it holds level with its hinge")

    @property
    def most_j(self) -> float:
        """Its energy when released level with its hinge [J]."""
        return self.mass * self.gravity * self.length

    def release_angle(self, energy_j: float) -> float:
        """From hanging to release [rad], so that the energy at the lowest point is m g L (1 - cos angle).

        Raises:
            UsageError: not positive, or more than the pendulum holds when released level with its hinge.
        """
        if not 0.0 < energy_j <= self.most_j:
            raise UsageError(
                f"a push of {energy_j:g} J: this pendulum can give more than 0 and at most {self.most_j:.1f} J"
            )
        return acos(1.0 - energy_j / self.most_j)


_ABOVE = {
    "mass": (1e3, "kg"),
    "length": (100.0, "m"),
    "height": (100.0, "m"),
    "radius": (10.0, "m"),
    "contact_s": (10.0, "s"),
    "retrieve_s": (10.0, "s"),
    "gravity": (100.0, "m/s^2"),
}
