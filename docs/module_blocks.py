"""Modules of the reference: a heading with the name of one is followed by what its docstrings say."""

from __future__ import annotations

import re

from sphinx.application import Sphinx

_SECTION = re.compile(r"^### (massprop_drake[\w.]*)\n(?:(?!^##).*\n?)*", re.MULTILINE)
_BLOCK = "\n```{{eval-rst}}\n.. automodule:: {}\n   :members:\n```\n\n"


def with_blocks(text: str) -> str:
    """A page's text with a block in every section that is headed by a module and has none of its own."""

    def section(found: re.Match[str]) -> str:
        return found[0] if "automodule" in found[0] else found[0].rstrip("\n") + "\n" + _BLOCK.format(found[1])

    return _SECTION.sub(section, text)


def setup(app: Sphinx) -> dict[str, bool]:
    """Has the pages of the reference read with these blocks."""

    def read(_: Sphinx, name: str, source: list[str]) -> None:
        if name.startswith("reference/"):
            source[0] = with_blocks(source[0])

    app.connect("source-read", read)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
