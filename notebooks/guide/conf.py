"""How Sphinx builds the guide: `make docs`. Nothing is fetched, neither while building nor while reading."""

import re
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parents[1])]

import frasa_rl  # noqa: F401 (before MuJoCo, which draws without a display then)
import frasa_sysid

project = "frasa"
author = "The frasa founders"
release = version = frasa_sysid.__version__
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",  # Google style
    "extensions.mathml",  # formulas without JavaScript
    "extensions.command_line",  # options from the parsers themselves
    "extensions.generated",  # pictures and tables from the project's own logs
]
exclude_patterns = ["extensions", "generated/*.md"]
default_role = "code"  # `x` in a docstring is code

myst_enable_extensions = ["dollarmath", "amsmath", "colon_fence", "deflist"]
myst_heading_anchors = 3

autodoc_member_order = "bysource"
autodoc_default_options = {"members": True}
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
python_maximum_signature_line_length = 100
napoleon_use_ivar = True  # fields of a dataclass stand once
napoleon_attr_annotations = False  # types stand in the signature
napoleon_google_docstring = True
napoleon_numpy_docstring = False
# Types in signatures that lead nowhere: of other packages, for nothing is fetched, and of ours that nobody imports.
nitpick_ignore_regex = [("py:.*", r"(?!frasa_(sysid|rl)\.).*"), ("py:class", r".*")]

html_theme = "furo"
html_title = f"frasa {release}"
html_math_renderer = "mathml"
html_static_path = ["figures"]
html_css_files = ["guide.css"]
html_copy_source = False
html_show_sourcelink = False
html_last_updated_fmt = None  # the same input gives the same pages


def short_signature(app, what, name, obj, options, signature, result):
    """Arrays by a short name."""
    array = re.compile(r"ndarray\[tuple\[Any, \.\.\.\], dtype\[(\w+)\]\]")
    return tuple(one and array.sub(r"array[\1]", one) for one in (signature, result))


def setup(app):
    """Register with Sphinx."""
    app.connect("autodoc-process-signature", short_signature)
