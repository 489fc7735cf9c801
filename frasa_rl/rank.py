"""Which of several policies to take: speed, robustness, mechanical safety and versatility, each a rank.

    speed        mean time to stand up, a failure counted as the limit of 10 s [s]
    robustness   share of the trials on random robots and floors that succeed, stand-ups and pushes
    safety       mean rank of five numbers: peak torque, peak speed, peak floor force, self-contact, shaking
    versatility  share of the 2 sides and 6 pushes in which at least 8 of 10 trials succeed

Equal numbers share the mean of their ranks. The place is by the mean of the four ranks; a policy that never stood
up in the nominal trials comes after all that did.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from frasa_rl.evaluate import Evaluation
from frasa_rl.instruments import MEASURES
from frasa_rl.protocol import LIMIT_S, SIDES

CRITERIA = ("speed", "robustness", "safety", "versatility")
PASS_SHARE = 0.8
_HIGH_IS_GOOD = frozenset({"robustness", "versatility"})


@dataclass(frozen=True)
class Place:
    """Where a candidate comes.

    Attributes:
        name: of the candidate.
        place: 1 is best; shared by equals.
        mean_rank: of the four criteria.
        stands_up: it stood up at least once on the robot as its file says.
        ranks: by criterion.
        numbers: behind the ranks; units in `rank.py` and `MEASURES`.
    """

    name: str
    place: int
    mean_rank: float
    stands_up: bool
    ranks: dict[str, float]
    numbers: dict[str, float]


def numbers_of(nominal: Evaluation, randomized: Evaluation) -> dict[str, float]:
    """The numbers of a candidate, from trials on the robot as its file says and on random ones."""
    times = [LIMIT_S if one.time_s is None else one.time_s for one in nominal.standup]
    drawn = [one.time_s is not None for one in randomized.standup]
    drawn += [one.time_s is not None for one in randomized.push]
    strained = [one.strain for one in nominal.standup] + [one.strain for one in nominal.push if one.hit]
    strain = np.mean(strained, axis=0)
    return {
        "speed": float(np.mean(times)),
        "robustness": float(np.mean(drawn)),
        "versatility": _versatility(nominal),
        "stood_up": float(np.mean([one.time_s is not None for one in nominal.standup])),
        **{one.name: float(value) for one, value in zip(MEASURES, strain, strict=True)},
    }


def _versatility(nominal: Evaluation) -> float:
    cells: dict[tuple[str, float], list[bool]] = {(side, 0.0): [] for side in SIDES}
    for one in nominal.standup:
        cells[one.side, 0.0].append(one.time_s is not None)
    for push in nominal.push:
        cells.setdefault((push.direction, push.energy_j), []).append(push.time_s is not None)
    return float(np.mean([np.mean(row) >= PASS_SHARE - 1e-9 for row in cells.values() if row]))


def rank(candidates: Mapping[str, Mapping[str, float]]) -> list[Place]:
    """The candidates, best first.

    Args:
        candidates: numbers of each (`numbers_of`), by name.
    """
    names = list(candidates)
    by = {
        key: _ranks([candidates[name][key] for name in names], high=key in _HIGH_IS_GOOD)
        for key in ("speed", "robustness", "versatility", *(one.name for one in MEASURES))
    }
    by["safety"] = np.mean([by[one.name] for one in MEASURES], axis=0)
    means = np.mean([by[key] for key in CRITERIA], axis=0)
    stands = [candidates[name]["stood_up"] > 0.0 for name in names]
    keys = [(not up, round(float(mean), 9)) for up, mean in zip(stands, means, strict=True)]
    places = [
        Place(
            name=name,
            place=1 + sum(other < keys[i] for other in keys),
            mean_rank=float(means[i]),
            stands_up=stands[i],
            ranks={key: float(by[key][i]) for key in CRITERIA},
            numbers=dict(candidates[name]),
        )
        for i, name in enumerate(names)
    ]
    return sorted(places, key=lambda one: one.place)


def _ranks(values: Sequence[float], *, high: bool) -> np.ndarray:
    """1 for the best; equals share the mean of theirs, shape (candidates,)."""
    array = np.round(-np.asarray(values) if high else np.asarray(values), 9)
    return np.array([1.0 + (array < one).sum() + 0.5 * ((array == one).sum() - 1) for one in array])


def rank_table(places: Sequence[Place]) -> str:
    """All numbers and ranks, a candidate a line."""
    columns = [
        ("place", "", 6),
        ("mean rank", "", 10),
        ("speed", "s", 14),
        ("robustness", "", 16),
        ("versatility", "", 17),
    ]
    columns += [(one.name, one.unit, len(one.name) + len(one.unit) + 4) for one in MEASURES]
    columns += [("safety rank", "", 12)]
    wide = max(len("candidate"), *(len(one.name) for one in places))
    titles = [f"{name} [{unit}]" if unit else name for name, unit, _ in columns]
    lines = ["  ".join(["candidate".ljust(wide), *(t.rjust(w) for t, (_, _, w) in zip(titles, columns, strict=True))])]
    for one in places:
        words = [str(one.place), f"{one.mean_rank:.2f}"]
        words += [
            _ranked(one, "speed", "{:.2f}"),
            _ranked(one, "robustness", "{:.0%}"),
            _ranked(one, "versatility", "{:.0%}"),
        ]
        words += [f"{one.numbers[each.name]:.3g}" for each in MEASURES]
        words += [f"{one.ranks['safety']:.2f}"]
        tail = "" if one.stands_up else "  never stood up"
        cells = (word.rjust(width) for word, (_, _, width) in zip(words, columns, strict=True))
        lines.append("  ".join([one.name.ljust(wide), *cells]) + tail)
    return "\n".join(lines)


def _ranked(one: Place, key: str, form: str) -> str:
    return f"{form.format(one.numbers[key])} ({one.ranks[key]:g})"
