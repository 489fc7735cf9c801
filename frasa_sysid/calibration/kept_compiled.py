"""Compiled functions that are kept on disk, where there is a folder that can be written.

Numba keeps them beside the source or in the user's cache. Where neither can be written (an installation for all users,
a service without a home) it refuses to compile at all; here they are compiled anew at every start instead. A folder
that everybody may write, such as that for temporary files, is no way out: what lies there is executed.
"""

from collections.abc import Callable
from typing import Any, TypeVar, cast

from numba import njit

from frasa_sysid.calibration.command_line import say

_Written = TypeVar("_Written", bound=Callable[..., Any])
_told: list[str] = []
_WORDS = (
    "compiled code cannot be kept: neither the folder of {name} nor the user's cache can be written, so every start "
    "compiles anew, some seconds to a minute; NUMBA_CACHE_DIR=FOLDER names one that can"
)


def kept(**options: Any) -> Callable[[_Written], _Written]:  # noqa: ANN401 - what Numba takes
    """Compile a function and keep the result on disk.

    Args:
        options: of `numba.njit`.
    """

    def compiled(function: _Written) -> _Written:
        try:
            return cast(_Written, njit(cache=True, **options)(function))
        except RuntimeError as error:
            if "cannot cache" not in str(error):
                raise
            if not _told:
                _told.append(function.__module__)
                say(_WORDS.format(name=function.__module__))
            return cast(_Written, njit(**options)(function))

    return compiled
