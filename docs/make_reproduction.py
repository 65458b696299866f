"""Puts the tables of a finished reproduction into docs/reproduction.md, below its mark.

    massprop reproduce --out runs/reproduction
    python docs/make_reproduction.py runs/reproduction

What stands above the mark is written by hand.
"""

from __future__ import annotations

import sys
from pathlib import Path

PAGE = Path(__file__).parent / "reproduction.md"
MARK = "<!-- below: written by docs/make_reproduction.py -->\n"


def updated(page: str, report: str) -> str:
    """Returns the page with a report's tables, without its title and pictures.

    Raises:
        ValueError: when the page has no mark.
    """
    above, mark, _ = page.partition(MARK)
    if not mark:
        raise ValueError(f"the page has no line {MARK.strip()!r}")
    lines = [line for line in report.splitlines() if not line.startswith(("# ", "!["))]
    tables = "\n".join(lines).strip().replace("\n\n\n", "\n\n")
    return f"{above}{mark}\n{tables}\n"


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    report = (folder / "reproduction.md").read_text(encoding="utf-8")
    PAGE.write_text(updated(PAGE.read_text(encoding="utf-8"), report), encoding="utf-8")
