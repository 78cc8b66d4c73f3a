"""Formulas as MathML, which browsers draw without a script or fonts from elsewhere."""

from __future__ import annotations

import re

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.util.math import get_node_equation_number
from sphinx.writers.html5 import HTML5Translator


_log = logging.getLogger(__name__)

# Delimiters of a given size, which the converter leaves as they are.
_DELIMITERS = {r"\{": "{", r"\}": "}", r"\|": "‖"}


def _mathml(node: nodes.Element, display: str) -> str:
    """A formula as MathML; a warning for a command that the converter does not know."""
    text = convert(node.astext(), display=display)
    for command, delimiter in _DELIMITERS.items():
        text = text.replace(f">{command}<", f">{delimiter}<")
    unknown = re.search(r">(\\\w*)", text)
    if unknown:
        _log.warning("the formula %s has the command %s, which is not converted", node.astext(), unknown[1], location=node)
    return text


def _inline(writer: HTML5Translator, node: nodes.math) -> None:
    writer.body.append(_mathml(node, "inline"))
    raise nodes.SkipNode


def _block(writer: HTML5Translator, node: nodes.math_block) -> None:
    writer.body.append(writer.starttag(node, "div", CLASS="math notranslate nohighlight"))
    if node["number"]:
        number = get_node_equation_number(writer, node)
        writer.body.append(f'<span class="eqno">({number})</span>')
    writer.body.append(_mathml(node, "block"))
    writer.body.append("</div>\n")
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
