"""A fit, and a choice among friction laws, in one call: for notebooks and scripts; the commands tell progress too."""

from collections.abc import Sequence

from frasa_sysid.bench import Bench
from frasa_sysid.calibration.friction import LAWS
from frasa_sysid.choice import Choice, choose
from frasa_sysid.fit import RESTARTS, FitResult, fit
from frasa_sysid.spread import spread_over


def fit_bench(
    bench: Bench,
    law: str = "m1",
    effects: Sequence[str] = (),
    restarts: int = RESTARTS,
    seed: int = 0,
    threads: int | None = None,
    choice: Choice | None = None,
) -> FitResult:
    """Fit a friction law to a bench's logs.

    Args:
        bench: logs to fit and to hold out.
        law: `m1` to `m6`.
        effects: names of `effects.EFFECTS`.
        restarts: searches that must agree.
        seed: of the search.
        threads: by default one per core.
        choice: of these very logs: its law and effects are fitted, from its solution on.

    Raises:
        LogError, UsageError, ModelError: bad input.
    """
    with bench.session(threads=threads) as session:
        if choice is not None:
            return fit(choice.problem, session, bench.inputs, restarts=restarts, known=(choice.x,))
        return fit(bench.problem(session, law, effects, seed), session, bench.inputs, restarts=restarts)


def choose_bench(
    bench: Bench,
    laws: Sequence[str] = LAWS,
    effects: Sequence[str] | None = (),
    seed: int = 0,
    threads: int | None = None,
) -> Choice:
    """Let runs that are held out in turn choose among friction laws.

    Args:
        bench: the logs; those held out already are left alone.
        laws: to choose from.
        effects: to switch on; None to choose them too, which takes several times as long.
        seed: of the searches.
        threads: by default one per core.

    Raises:
        LogError, UsageError, ModelError: bad input.
    """
    with bench.session(threads=threads) as session, spread_over(1, None) as spread:
        return choose(bench.problem(session, seed=seed), session, laws, effects, spread, lambda *_: None)
