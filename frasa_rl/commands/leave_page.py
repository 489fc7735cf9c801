"""A page at the end of work that is saved already, whatever becomes of the page."""

from collections.abc import Callable
from pathlib import Path

from frasa_sysid.calibration import say, tell_report


def leave_page(write: Callable[[], Path | None]) -> Path | None:
    """Write a page and say where it is; where that fails, say why and go on.

    Args:
        write: makes the page.

    Returns:
        The page; None without one.
    """
    try:
        page = write()
    except KeyboardInterrupt:
        say("no report page: interrupted")
        return None
    except Exception as error:  # hours of training shall not end in an error of a picture of them
        say(f"no report page: {' '.join(str(error).split()) or type(error).__name__}")
        return None
    tell_report(page)
    return page
