"""Resolution of names of types that several modules have, such as `Bank`, to the module where they are written."""

from __future__ import annotations

import sys

from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.transforms.post_transforms import SphinxPostTransform


class OwnNames(SphinxPostTransform):
    """Resolves a reference to a bare name to the module that the name is from, before Sphinx looks for it anywhere."""

    default_priority = 5  # before references are resolved

    def run(self) -> None:
        """Goes through the references of a page."""
        for node in self.document.findall(addnodes.pending_xref):
            module, name = sys.modules.get(node.get("py:module") or ""), node.get("reftarget", "")
            found = getattr(module, name, None) if node.get("refdomain") == "py" else None
            if isinstance(found, type) and found.__module__.startswith("massprop_drake."):
                node["reftarget"] = f"{found.__module__}.{found.__qualname__}"


def setup(app: Sphinx) -> dict[str, bool]:
    """Adds the transform."""
    app.add_post_transform(OwnNames)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
