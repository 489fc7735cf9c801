"""What a robot's fit has decided so far: enough to go on after a kill, to the very result of an unbroken fit.

Slopes and residuals are too large to be kept with every step. Kept is where slopes were last computed, and which point
each step since then took: the same slopes are computed again there, and of each step only its outcome.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from frasa_sysid.recording import FloatArray


@dataclass(frozen=True)
class Place:
    """Where slopes were computed, and what came after.

    Attributes:
        stage: which of the fit's searches it is in.
        x: the point, n numbers.
        units: noise unit of each group there; None for those that its residuals show.
        iteration: number of the step that follows.
        used: robots simulated before.
        cost: before; None at the beginning.
        weighing: whether these are the slopes that intervals come from.
        converged: whether the search had converged by then.
        moves: of each step since: which of the points it tried was taken (-1 for none), robots simulated.
    """

    stage: str
    x: tuple[float, ...]
    units: tuple[float, ...] | None = None
    iteration: int = 1
    used: int = 0
    cost: float | None = None
    weighing: bool = False
    converged: bool = False
    moves: tuple[tuple[int, int], ...] = ()

    @property
    def cost_before(self) -> float:
        """The cost before; infinite at the beginning."""
        return np.inf if self.cost is None else self.cost

    @property
    def units_array(self) -> FloatArray | None:
        """Noise units, (groups,)."""
        return None if self.units is None else np.array(self.units)


def place_from(data: Any) -> Place:  # noqa: ANN401 - as a file has it
    """A place as it was saved.

    Raises:
        ValueError, KeyError, TypeError: it is none.
    """
    units = None if data["units"] is None else tuple(float(one) for one in data["units"])
    moves = tuple((int(taken), int(used)) for taken, used in data["moves"])
    if not np.isfinite([*(float(one) for one in data["x"]), *(units or ())]).all():
        raise ValueError("a place that is not finite")
    return Place(
        str(data["stage"]),
        tuple(float(one) for one in data["x"]),
        units,
        int(data["iteration"]),
        int(data["used"]),
        None if data["cost"] is None else float(data["cost"]),
        bool(data["weighing"]),
        bool(data["converged"]),
        moves,
    )


class Trail:
    """The places of a fit as it goes, and the one that an earlier run of it had reached.

    Args:
        past: of the earlier run.
        save: keeps a place, as plain data.
    """

    def __init__(self, past: Place | None = None, save: Callable[[dict[str, Any]], None] = lambda place: None) -> None:
        self._past, self._save = past, save
        self._now = Place("", ())
        self._known: list[tuple[int, int]] = []

    def reached(self, stage: str) -> bool:
        """Whether the earlier run had come to a stage."""
        return self._past is not None and self._past.stage == stage

    def enter(self, stage: str, x: FloatArray) -> Place:
        """Where a stage begins, or goes on: from x (n,) unless the earlier run had come further."""
        if self._past is not None and self._past.stage == stage and len(self._past.x) == x.size:
            self._now, self._known, self._past = self._past, list(self._past.moves), None
        else:
            self.mark(Place(stage, tuple(x.tolist())))
        return self._now

    def mark(self, place: Place) -> None:
        """Slopes are computed anew."""
        self._now, self._known = place, []
        self._save(asdict(place))

    def known(self) -> tuple[int, int] | None:
        """What the earlier run's next step came to: point taken (-1 for none), robots simulated."""
        return self._known.pop(0) if self._known else None

    def moved(self, taken: int, used: int) -> None:
        """A step is over that no earlier run had done."""
        self._now = replace(self._now, moves=(*self._now.moves, (taken, used)))
        self._save(asdict(self._now))
