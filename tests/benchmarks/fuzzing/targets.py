"""What a campaign reads with: each format, the reader that a command would call, and its good inputs."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fuzzing.case import Case

Read = Callable[[Path], int]  # losses counted


@dataclass(frozen=True)
class Target:
    """A format.

    Attributes:
        seeds: makes its good inputs.
        reader: makes what reads one; it is made in the worker, where nothing is watched yet.
        share: inputs of a campaign, relative to the other formats.
    """

    seeds: Callable[[], list[Case]]
    reader: Callable[[], Read]
    share: float = 1.0


class WrongReadError(Exception):
    """Something was read that no recording may hold."""


def losses(recordings: list) -> int:  # type: ignore[type-arg]
    """What a reader counted as lost or odd, after a look at what it let through."""
    if not recordings:
        raise WrongReadError("no recording and no error")
    for one in recordings:
        for signal in one.signals.values():
            if not (np.isfinite(signal.t).all() and np.isfinite(signal.y).all()):
                raise WrongReadError(f"{signal.name} is not finite")
            if signal.t.size == 0 or (np.diff(signal.t) <= 0).any():
                raise WrongReadError(f"{signal.name}: time does not run")
    return sum(fault.count for one in recordings for fault in one.faults)


def targets() -> Mapping[str, Target]:
    """All formats by name."""
    from fuzzing.targets_rl import TARGETS as RL
    from fuzzing.targets_sysid import TARGETS as SYSID

    return {**SYSID, **RL}
