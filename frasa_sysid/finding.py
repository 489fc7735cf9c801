"""Whether the logs can tell one thing, and which log would help if they cannot."""

from dataclasses import dataclass
from typing import Literal

Verdict = Literal["yes", "weak", "no"]


@dataclass(frozen=True)
class Finding:
    """Whether one thing can be identified.

    Attributes:
        parameter: what it is about.
        verdict: yes, weak (an interval so wide that it says little, or a caveat) or no.
        reason: what in the logs makes it so.
        record: the log that would help; empty when none is needed.
    """

    parameter: str
    verdict: Verdict
    reason: str
    record: str = ""
