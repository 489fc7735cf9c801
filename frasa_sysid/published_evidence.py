"""Whether the numbers that a fit puts into a model come from its logs: a gate, and a line for those that do not."""

from collections.abc import Sequence

from frasa_sysid.errors import QualityError
from frasa_sysid.stored_fit import StoredFit, model_parameters
from frasa_sysid.stored_robot_fit import StoredRobotFit

NOT_EXCITED = "not excited"


def check_evidence(fits: Sequence[StoredFit]) -> None:
    """Of every servo the logs must tell at least one number of its actuator.

    Raises:
        QualityError: of one they tell nothing, so that its numbers are where the search happened to end.
    """
    for one in fits:
        names = list(model_parameters(one))
        if names and len(_untold(one)) == len(names):
            raise QualityError(
                f"fit {one.sha256[:12]} of {one.servo}: all {len(names)} numbers of its actuator are {NOT_EXCITED}, "
                "no model is made of them: record what frasa-sysid inspect LOG asks for, and fit again"
            )


def evidence_words(fits: Sequence[StoredFit], robot: StoredRobotFit | None = None) -> list[str]:
    """Which numbers stand in a model without evidence, a sentence for each fit that has any."""
    found = [(one.servo, _untold(one)) for one in fits]
    if robot is not None:
        untold = [name for name, one in robot.published.items() if NOT_EXCITED in one["verdict"]]
        found.append(("robot", untold))
    return [f"{whose}, in the model without evidence ({NOT_EXCITED}): {', '.join(one)}" for whose, one in found if one]


def _untold(stored: StoredFit) -> list[str]:
    return [name for name, one in model_parameters(stored).items() if NOT_EXCITED in one["verdict"]]
