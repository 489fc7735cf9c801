"""The one look of all figures that frasa draws, and figures as elements of a page.

Colours are those of Okabe and Ito, which all eyes tell apart. matplotlib is imported where something is drawn, so
that whoever draws nothing does not need it.
"""

import base64
import io
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from frasa_sysid.calibration.command_line import say
from frasa_sysid.calibration.page import Html, esc

if TYPE_CHECKING:
    from matplotlib.figure import Figure

INK, SOFT = "#1d2733", "#5b6875"
BLUE, RED, GREEN, ORANGE, SKY, PURPLE = "#0072b2", "#d55e00", "#009e73", "#e69f00", "#56b4e9", "#cc79a7"
GREY = "#7d8894"
HINT = "matplotlib is not installed (pip install 'frasa[report]')"

_PIXELS = 104  # of the page for an inch of a figure; it is drawn finer, for screens that show more
_DPI = 130
_LOOK: dict[Any, Any] = {
    "font.family": "sans-serif",
    "font.size": 8.5,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.titlecolor": INK,
    "axes.labelsize": 8.5,
    "axes.labelcolor": INK,
    "axes.edgecolor": "#8793a0",
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#b9c3cd",
    "grid.alpha": 0.45,
    "grid.linewidth": 0.5,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "xtick.color": "#8793a0",
    "ytick.color": "#8793a0",
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "legend.fontsize": 8,
    "legend.framealpha": 0.85,
    "legend.edgecolor": "none",
    "text.color": INK,
    "text.parse_math": False,  # a name with a dollar sign is no formula
    "figure.titlesize": 10,
    "svg.hashsalt": "frasa",  # the same figure gives the same file
}


def has_matplotlib() -> bool:
    """Whether pictures can be drawn; says so where they cannot."""
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        say(f"no report page: {HINT}")
        return False
    return True


def wear_look(dpi: int = 80) -> None:
    """All figures from here on look like those of the pages: for notebooks, which draw where nobody can wrap them.

    Args:
        dpi: of what a notebook stores; a page's width of 11 inches is 880 pixels at 80.

    Raises:
        ModuleNotFoundError: matplotlib is not installed.
    """
    import matplotlib
    from cycler import cycler  # matplotlib's own
    from matplotlib import pyplot

    if "inline" in (backend := str(matplotlib.rcParams["backend"])):
        pyplot.switch_backend(backend)  # else figures that were not made by pyplot are words to a notebook
    # Here it is the user who writes the texts, formulas among them; and lines without a colour get one of ours.
    cycle = cycler(color=[BLUE, ORANGE, GREEN, RED, PURPLE, SKY, GREY])
    own: dict[Any, Any] = {"figure.dpi": dpi, "axes.prop_cycle": cycle, "text.parse_math": True}
    matplotlib.rcParams.update({**_LOOK, **own})


@contextmanager
def look() -> Iterator[None]:
    """What is made and drawn inside looks like all figures of frasa, whatever the user's own settings are.

    Raises:
        ModuleNotFoundError: matplotlib is not installed.
    """
    import matplotlib

    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(_LOOK)
        yield


def image(figure: "Figure", meaning: str) -> Html:
    """A figure as an element of the page; the same figure gives the same bytes."""
    buffer = io.BytesIO()
    with warnings.catch_warnings():
        # A name in letters that the font lacks is a row of boxes in a picture; the page around it has it in full.
        warnings.filterwarnings("ignore", message=r"Glyph .* missing from font")
        figure.savefig(buffer, format="png", dpi=_DPI, metadata={"Software": None})
    return image_of(buffer.getvalue(), "png", meaning, round(float(figure.get_figwidth()) * _PIXELS))


def image_of(content: bytes, kind: str, meaning: str, width: int | None = None) -> Html:
    """A picture's file as an element of the page.

    Args:
        content: of the file.
        kind: `png`, `webp`, `gif` or `jpeg`.
        meaning: for those who do not see it.
        width: on the page [px]; its own by default.
    """
    wide = "" if width is None else f' width="{width}"'
    data = base64.b64encode(content).decode()
    return Html(f'<img alt="{esc(meaning)}"{wide} src="data:image/{kind};base64,{data}">')
