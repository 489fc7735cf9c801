"""Inputs that were made to do harm, by format: bombs, climbing paths, entities, pickles, absurd sizes, deep nesting."""

from collections.abc import Callable, Mapping

from fuzzing import hostile_logs, hostile_models, hostile_rl, hostile_texts
from fuzzing.case import Case

MADE: Mapping[str, Callable[[], list[Case]]] = {
    **hostile_logs.MADE,
    **hostile_models.MADE,
    **hostile_texts.MADE,
    **hostile_rl.MADE,
}


def hostile(form: str) -> list[Case]:
    """Those of a format; the note names each."""
    return MADE[form]() if form in MADE else []
