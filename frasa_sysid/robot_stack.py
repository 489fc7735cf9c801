"""Several comparisons, of a robot held and of the same one on the ground, as one."""

from collections.abc import Sequence

import numpy as np

from frasa_sysid.recording import FloatArray
from frasa_sysid.robot_problem import RobotProblem
from frasa_sysid.robot_residuals import Comparison, Layout, whitened


class Stack:
    """Several comparisons (a held robot and one on the ground) as one."""

    def __init__(self, comparisons: Sequence[Comparison]) -> None:
        self._parts = list(comparisons)
        columns, clusters, befores, names = [], [], [], []
        groups = owners = size = 0
        for part in self._parts:
            columns.append(part.layout.column + groups)
            clusters.append(part.layout.cluster + owners)
            befores.append(np.where(part.layout.before >= 0, part.layout.before + size, -1))
            size += part.layout.before.size
            names += [f"{part.simulator.base} {name}" for name in part.layout.names]
            groups, owners = len(names), owners + int(part.layout.cluster.max()) + 1
        self.layout = Layout(
            np.concatenate(columns),
            np.concatenate(clusters),
            tuple(names),
            np.concatenate([part.layout.floors for part in self._parts]),
            np.concatenate([part.layout.thinning for part in self._parts]),
            np.concatenate(befores),
            np.concatenate([part.layout.memory for part in self._parts]),
        )

    def residuals(self, problem: RobotProblem, points: FloatArray, centre: FloatArray) -> FloatArray:
        """Whitened residuals of points (m, n), pieces started as the centre (n,) has it: (m, R)."""
        return whitened(self.raw(problem, points, centre), self.layout)

    def raw(self, problem: RobotProblem, points: FloatArray, centre: FloatArray) -> FloatArray:
        """Simulated minus measured of points (m, n): (m, R)."""
        candidates = [problem.candidate(x) for x in points]
        return np.hstack([part.residuals(candidates, problem.candidate(centre)) for part in self._parts])
