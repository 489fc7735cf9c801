"""Publishing a richer friction law as the Coulomb-viscous servo that best stands in for it."""

from dataclasses import replace

import numpy as np

from frasa_sysid.calibration import parameter
from frasa_sysid.calibration.friction import LAWS
from frasa_sysid.errors import CalibrationError
from frasa_sysid.stored_fit import NUMBERS, StoredFit


def as_m1(stored: StoredFit) -> StoredFit:
    """The fit with its Coulomb-viscous stand-in in place of its law; an `m1` fit as it is.

    The intervals keep their widths around the stand-in's values: what load and speed do to a
    friction that is one number is the penalty, not part of any interval.

    Raises:
        CalibrationError: the fit holds no stand-in.
    """
    if stored.friction == LAWS[0]:
        return stored
    if stored.stand_in is None:
        raise CalibrationError(f"the fit {stored.sha256[:12]} of {stored.servo} holds no stand-in as m1; fit again")
    parameters = {}
    for field, value in stored.stand_in.values.items():
        name = f"{stored.servo}.{field}"
        if name in stored.parameters:
            old = stored.parameters[name]
            parameters[name] = {**old, **{key: old[key] - old["value"] + value for key in NUMBERS}, "value": value}
        else:  # it was not fitted, so no range can be told
            unfitted = dict.fromkeys(NUMBERS, value)
            parameters[name] = {**unfitted, "unit": parameter(name).unit, "verdict": "not excited"}
    index = [i for i, name in enumerate(stored.correlated) if name in parameters]
    return replace(
        stored,
        parameters=parameters,
        correlated=tuple(stored.correlated[i] for i in index),
        correlation=stored.correlation[np.ix_(index, index)],
        friction=LAWS[0],
        law=None,
        stands_for=stored.friction,
    )


def price(stored: StoredFit) -> str:
    """What a stand-in costs and where it holds, in words; empty for a fit that is none."""
    if not stored.stands_for or stored.stand_in is None:
        return ""
    one = stored.stand_in
    return (
        f"stands in for friction law {stored.stands_for} at loads of {one.loads[0]:.3g} .. {one.loads[1]:.3g} N m and "
        f"up to {one.speed:.3g} rad/s, on the motions of the logs {one.penalty_rad * 1e3:.2f} mrad away on average"
    )
