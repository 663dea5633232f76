"""Equations as MathML, made while the site is built.

Browsers render MathML themselves (Chromium since 109, Firefox, Safari), so a page with
equations needs no script, no font and no network. The converter is docutils' own, which Sphinx
brings: MathJax would be megabytes beside the pages, images would need LaTeX to build.
"""

from docutils import nodes
from docutils.utils.math import MathError, latex2mathml
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.util.math import get_node_equation_number
from sphinx.writers.html5 import HTML5Translator

LOGGER = logging.getLogger(__name__)


def mathml(node: nodes.Element, display: bool) -> str:
    """Convert the equation of a node to MathML; failures are warnings of the build."""
    try:
        return latex2mathml.tex2mathml(node.astext(), as_block=display)
    except MathError as error:
        LOGGER.warning("equation: %s", error, location=node)
        return "<code></code>"


def visit_inline(translator: HTML5Translator, node: nodes.math) -> None:
    """Write an equation inside a line."""
    translator.body.append(f'<span class="math">{mathml(node, display=False)}</span>')
    raise nodes.SkipNode


def visit_display(translator: HTML5Translator, node: nodes.math_block) -> None:
    """Write an equation on a line of its own, with its number if it has a label."""
    translator.body.append(translator.starttag(node, "div", CLASS="math equation"))
    translator.body.append(mathml(node, display=True))
    if node.get("number"):
        number = get_node_equation_number(translator, node)
        translator.body.append(f'<span class="eqno">({number})</span>')
    translator.body.append("</div>\n")
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the renderer under the name ``mathml``."""
    app.add_html_math_renderer("mathml", (visit_inline, None), (visit_display, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
