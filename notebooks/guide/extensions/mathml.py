"""Formulas as MathML, which browsers draw by themselves: no JavaScript, no network. The work is docutils' own."""

import html
import re
from typing import Any

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.util import logging

# An index of a letter with dots belongs beside it, not below.
_DOTTED = re.compile(
    r"<munderover>\s*(<m\w+>[^<]*</m\w+>)\s*(<(m\w+)>.*?</\3>)\s*(<mo[^>]*>[˙¨]</mo>)\s*</munderover>", re.DOTALL
)
log = logging.getLogger(__name__)


def mathml(latex: str, node: nodes.Element, *, block: bool) -> str:
    """MathML of a formula; one that cannot be read is a warning, so a failed build, and stays as text."""
    lines = block and "\\\\" in latex and "\\begin" not in latex
    try:
        drawn = tex2mathml(f"\\begin{{aligned}}{latex}\\end{{aligned}}" if lines else latex, as_block=block)
        return _DOTTED.sub(r"<msub><mover>\1\4</mover>\2</msub>", drawn)
    except MathError as error:
        log.warning("formula %r: %s", latex, error, location=node)
        return f"<code>{html.escape(latex)}</code>"


def _inline(translator: Any, node: nodes.math) -> None:
    translator.body.append(mathml(node.astext(), node, block=False))
    raise nodes.SkipNode


def _block(translator: Any, node: nodes.math_block) -> None:
    translator.body.append(f'<div class="formula">{mathml(node.astext(), node, block=True)}</div>\n')
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    """Register with Sphinx."""
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
