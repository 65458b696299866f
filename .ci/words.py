"""Counts what makes names and docstrings hard to read, and fails when any count has grown: python .ci/words.py [ROOT].

- `fragments`: percent of docstring summaries that begin with a fragment ("What is left of ...", "Of a package.").
- `classes`: names of classes that stand in more than one file.
- `modules`: names of modules that stand more than once in the package.

The most that is allowed stands in `words.json` beside this file. Where a count has fallen, --write lowers it there.
"""

from __future__ import annotations

import argparse
import ast
import json
import re
import sys
from collections import defaultdict
from collections.abc import Iterator, Mapping
from pathlib import Path

ALLOWED = Path(__file__).with_name("words.json")
PACKAGE = ("massprop_drake", "diagrams", "scenarios")  # the last two are links within it, which globbing leaves out
DOCUMENTED = (*PACKAGE, "reproduction", "benchmarks", "docs")  # what tests show is said by their names
# pronouns, prepositions and conjunctions with which no sentence of a verb or a noun phrase begins
FRAGMENT = re.compile(
    r"\W*(and|as|at|because|before|but|by|for|from|how|however|if|in|instead|its?|lest|none|nor|of|on|only|others|since|so"
    r"|than|that|their|then|there|these|they|this|those|though|to|under|unless|until|what|whatever|when|where|wherever"
    r"|whether|which|who|whoever|whom|whose|why|with|within|without)(?![\w-])",
    re.IGNORECASE,
)
DIGITS = 1  # of a percentage: one summary of three thousand is no change


def summaries(tree: ast.Module) -> Iterator[str]:
    """First lines of the docstrings of a module, its classes and its functions."""
    for node in ast.walk(tree):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)):
            text = ast.get_docstring(node)
            if text:
                yield text.splitlines()[0]


def sources(root: Path, folders: tuple[str, ...]) -> Iterator[tuple[Path, ast.Module]]:
    """Python files below some folders of a repository, each once, with what they hold."""
    for folder in folders:
        for path in sorted((root / folder).rglob("*.py")):
            yield path, ast.parse(path.read_text(encoding="utf-8"), str(path))


def found(root: Path) -> dict[str, dict[str, list[str]]]:
    """Counts: the places of each by name; of summaries all, and those that are fragments.

    Raises:
        SyntaxError: when a file is no Python.
    """
    lines: dict[str, list[str]] = defaultdict(list)
    for path, tree in sources(root, DOCUMENTED):
        for summary in summaries(tree):
            lines["fragments" if FRAGMENT.match(summary) else "others"].append(f"{path.relative_to(root)}: {summary}")
    classes: dict[str, list[str]] = defaultdict(list)
    modules: dict[str, list[str]] = defaultdict(list)
    for path, tree in sources(root, PACKAGE):
        if path.stem not in ("__init__", "__main__"):
            modules[path.stem].append(str(path.relative_to(root)))
        for name in {node.name for node in ast.walk(tree) if isinstance(node, ast.ClassDef)}:
            classes[name].append(str(path.relative_to(root)))
    twice = {
        kind: {name: places for name, places in names.items() if len(places) > 1}
        for kind, names in (("classes", classes), ("modules", modules))
    }
    return {"fragments": dict(lines), **twice}


def counts(places: Mapping[str, Mapping[str, list[str]]]) -> dict[str, float]:
    """The three numbers."""
    bad, good = (len(places["fragments"].get(kind, ())) for kind in ("fragments", "others"))
    share = round(100.0 * bad / max(bad + good, 1), DIGITS)
    return {"fragments": share, "classes": len(places["classes"]), "modules": len(places["modules"])}


def main() -> int:
    """Compares the counts with what is allowed; exit status 1 when one has grown."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("root", nargs="?", type=Path, default=ALLOWED.parent.parent, help="of the repository")
    parser.add_argument("--allowed", type=Path, default=ALLOWED, help="file of the most that is allowed")
    parser.add_argument("--list", choices=("fragments", "classes", "modules"), help="print what is counted")
    parser.add_argument("--write", action="store_true", help="lower what is allowed to what there is")
    options = parser.parse_args()
    places = found(options.root)
    if options.list:
        shown = places[options.list]
        names = shown.get("fragments", []) if options.list == "fragments" else [f"{n}: {p}" for n, p in shown.items()]
        sys.stdout.write("\n".join(names) + "\n")
        return 0
    now, allowed = counts(places), json.loads(options.allowed.read_text(encoding="utf-8"))
    grown = [name for name in now if now[name] > allowed[name]]
    fallen = [name for name in now if now[name] < allowed[name]]
    for name in grown:
        sys.stderr.write(f"words: {name} has grown from {allowed[name]} to {now[name]}: --list {name} shows them\n")
    if fallen and options.write:
        lowered = {name: min(now[name], allowed[name]) for name in now}
        options.allowed.write_text(json.dumps(lowered, indent=2) + "\n", encoding="utf-8")
    elif fallen:
        told = ", ".join(f"{name} {now[name]} (allowed {allowed[name]})" for name in fallen)
        sys.stdout.write(f"words: fewer than allowed, lower them by --write: {told}\n")
    return 1 if grown else 0


if __name__ == "__main__":
    sys.exit(main())
