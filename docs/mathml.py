r"""Equations as MathML, which browsers draw by themselves: no script, no font, no network.

The translation from LaTeX is docutils'. It knows no \tag, so the number of an equation is taken out first and
set at its right. What it does not know is a warning, as any other mistake in a page.
"""

from __future__ import annotations

import html
import re
from typing import Any

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.util import logging

_TAG = re.compile(r"\\tag\{([^}]*)\}")
_ROW = "display: flex; align-items: center; overflow-x: auto; padding: 0.3em 0"
_NUMBER = "padding-left: 1em; opacity: 0.7; white-space: nowrap"


def _drawn(latex: str, node: nodes.Element, *, block: bool) -> str:
    try:
        drawn: str = tex2mathml(latex, as_block=block)
    except MathError as error:
        logging.getLogger(__name__).warning("equation %r: %s", latex.strip(), error, location=node)
        return f"<code>{html.escape(latex)}</code>"
    return drawn


def inline(translator: Any, node: nodes.math) -> None:
    """Draws an equation within a line."""
    translator.body.append(_drawn(node.astext(), node, block=False))
    raise nodes.SkipNode


def displayed(translator: Any, node: nodes.math_block) -> None:
    """Draws an equation on a line of its own, with its number."""
    text = node.astext()
    number = ", ".join(_TAG.findall(text))
    drawn = _drawn(_TAG.sub("", text), node, block=True)
    label = f'<span style="{_NUMBER}">({number})</span>' if number else ""
    translator.body.append(f'<div class="math" style="{_ROW}"><div style="flex: 1">{drawn}</div>{label}</div>\n')
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    """Registers the renderer."""
    app.add_html_math_renderer("mathml", inline_renderers=(inline, None), block_renderers=(displayed, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
