"""What fit files of every kind have in common as JSON: schema, size, and values that can be trusted."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from frasa_sysid.calibration import read_limited, sha256_of
from frasa_sysid.errors import InputError

SCHEMA_M1, SCHEMA = "frasa.fit/1", "frasa.fit/2"  # the first knows Coulomb-viscous friction only
SERVO, ROBOT = "servo", "robot"  # kinds; a file that names none is of a servo
_LARGEST = 2**25  # [bytes]
_LONGEST = 500  # characters of a text that is quoted elsewhere


def read_json(path: Path) -> tuple[dict[str, Any], str]:
    """Content of a fit file of any kind, not checked yet beyond its schema, and the file's sha256.

    Raises:
        InputError: missing, or not a fit file.
    """
    try:
        content = read_limited(path, _LARGEST, InputError)
        data = json.loads(content)
    except FileNotFoundError:
        raise InputError(f"no fit at {path}: make one with frasa-sysid fit LOG...") from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path} is not a fit file: {error}") from error
    if not isinstance(data, dict) or data.get("schema") not in (SCHEMA_M1, SCHEMA):
        raise InputError(f"{path} is not a fit file: expected schema '{SCHEMA}' or '{SCHEMA_M1}'")
    return data, sha256_of(content)


def checked_text(value: Any) -> str:  # noqa: ANN401 (whatever JSON holds)
    """A text that can be quoted in XML and YAML as it is."""
    if not isinstance(value, str) or len(value) > _LONGEST or not value.isprintable():
        raise ValueError(f"expected up to {_LONGEST} printable characters, found {str(value)[:80]!r}")
    return value


def checked_number(value: Any, name: str) -> float:  # noqa: ANN401
    """A finite number that is not negative."""
    number = float(value)
    if not (np.isfinite(number) and number >= 0.0):
        raise ValueError(f"{name} = {number}, expected a finite number, not negative")
    return number


def checked_interval(value: Any, name: str, least: float) -> tuple[float, float] | None:  # noqa: ANN401
    """Two numbers in order, the first not below `least`; None where there are none."""
    if value is None:
        return None
    if not isinstance(value, list):
        raise ValueError(f"{name}: expected [low, high], found {str(value)[:80]!r}")
    low, high = (float(one) for one in value)
    if not (np.isfinite([low, high]).all() and least <= low <= high):
        raise ValueError(f"{name}: {low} .. {high} is not finite, not in order or too low")
    return low, high
