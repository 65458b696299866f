"""Templates of all pages: each is filled once, and has a Content-Security-Policy.

A page is one file that needs no network. Text from a user's files gets into it in two ways: into its markup through
a template, which escapes it, and into its only block of data, which is JSON. The page's scripts read the block and
write with `textContent`; they are named in the policy by their digests, so that a browser runs nothing else.
"""

from __future__ import annotations

import base64
import functools
import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jinja2

_HERE = Path(__file__).parent

_POLICY = {
    "default-src": "'none'",
    "img-src": "data:",
    "base-uri": "'none'",
    "form-action": "'none'",
}


def page(
    template: Path,
    content: Mapping[str, Any],
    *,
    data: Any = None,
    styles: Sequence[str] = (),
    scripts: Sequence[str] = (),
    extra_policy: Mapping[str, str] | None = None,
) -> str:
    """Fills a template with content, data, styles and scripts; returns one HTML text with its security policy.

    Args:
        template: the file; it extends `frame.html` and fills its block `body`.
        content: values for the template, `title` among them; they are escaped.
        data: of the page's block `data`, as `json.dumps` takes it; None: it has no block.
        styles: style sheets.
        scripts: to be run in this order when the rest of the page is there.
        extra_policy: sources that libraries among the scripts need besides, by directive of the policy.

    Raises:
        ValueError: when data hold NaN or infinity, or a style or script would end its element.
    """
    policy = {
        **_POLICY,
        "script-src": _digests(scripts, "script"),
        "style-src": _digests(styles, "style"),
        **(extra_policy or {}),
    }
    filled: str = (
        environment(template.parent)
        .get_template(template.name)
        .render(
            content,
            policy="; ".join(f"{directive} {sources}" for directive, sources in policy.items()),
            data=data,
            styles=styles,
            scripts=scripts,
        )
    )
    return filled


def fragment(template: Path, content: Mapping[str, Any]) -> str:
    """Fills a template as HTML to embed in another page, such as a notebook; values are escaped, no scripts."""
    filled: str = environment(template.parent).get_template(template.name).render(content)
    return filled


@functools.cache
def environment(folder: Path) -> jinja2.Environment:
    """Returns the Jinja environment of a folder's templates and the common ones, cached."""
    loader = jinja2.FileSystemLoader([folder, _HERE])
    jinja = jinja2.Environment(loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True)
    jinja.policies["json.dumps_kwargs"] = {"allow_nan": False, "separators": (",", ":")}
    return jinja


def _digests(texts: Sequence[str], element: str) -> str:
    """Lists SHA-256 digests of inline styles or scripts, as sources of a Content-Security-Policy."""
    if any(f"</{element}" in text.lower() for text in texts):
        raise ValueError(f"the text of a {element} ends its element")
    digests = [base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() for text in texts]
    return " ".join(f"'sha256-{digest}'" for digest in digests) or "'none'"
