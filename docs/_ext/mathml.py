"""Formulas as MathML, which browsers draw themselves: no script, no font, nothing from outside."""

from html import escape
from typing import Any

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx
from sphinx.errors import ExtensionError


def _mathml(node: nodes.math | nodes.math_block, display: str) -> str:
    latex = node.astext()
    try:
        return convert(latex, display=display)
    except Exception as error:
        # Whatever the converter raises: a formula that is not drawn must not pass unseen.
        raise ExtensionError(f"{node.source}: formula {latex!r}: {error!r}") from error


def _inline(translator: Any, node: nodes.math) -> None:
    translator.body.append(_mathml(node, "inline"))
    raise nodes.SkipNode


def _block(translator: Any, node: nodes.math_block) -> None:
    number = node.get("number")
    translator.body.append(f'<div class="formula" id="{escape(node.get("label") or "")}">')
    translator.body.append(_mathml(node, "block"))
    if number is not None:
        translator.body.append(f'<span class="number">({number})</span>')
    translator.body.append("</div>\n")
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    """Called by Sphinx."""
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
    app.config.html_math_renderer = "mathml"
    return {"parallel_read_safe": True, "parallel_write_safe": True}
