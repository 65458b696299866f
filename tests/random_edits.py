"""Single edits drawn at random from the package's code: signs, comparisons, constants, conditions, dropped statements.

Text is edited, not the tree, so that the rest of a file stays as it is.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator
from pathlib import Path
from random import Random
from typing import NamedTuple

BINARY = {ast.Add: ("+", "-"), ast.Sub: ("-", "+"), ast.Mult: ("*", "/"), ast.Div: ("/", "*"), ast.MatMult: ("@", "*")}
COMPARED = {
    ast.Lt: ("<", ">="),
    ast.LtE: ("<=", ">"),
    ast.Gt: (">", "<="),
    ast.GtE: (">=", "<"),
    ast.Eq: ("==", "!="),
    ast.NotEq: ("!=", "=="),
    ast.Is: ("is", "is not"),
    ast.IsNot: ("is not", "is"),
    ast.In: ("in", "not in"),
    ast.NotIn: ("not in", "in"),
}
JOINED = {ast.And: ("and", "or"), ast.Or: ("or", "and")}


class Edit(NamedTuple):
    """Replacement of a piece of a file.

    Attributes:
        path: of the file.
        start, end: of the piece, in bytes.
        line: of its first byte, from 1.
        new: what takes its place.
    """

    path: Path
    start: int
    end: int
    line: int
    new: str

    @property
    def text(self) -> str:
        """The file with the edit made."""
        content = self.path.read_bytes()
        return (content[: self.start] + self.new.encode() + content[self.end :]).decode()

    @property
    def shown(self) -> str:
        """The edited line before, and the piece after."""
        content = self.path.read_bytes()
        line = content.decode().splitlines()[self.line - 1].strip()
        return f"{self.line}: {line}  [{content[self.start : self.end].decode()} -> {self.new}]"


def draw(paths: Iterable[Path], number: int, seed: int) -> list[Edit]:
    """Draws edits, each of all that are possible with the same probability, none twice."""
    possible = [edit for path in sorted(paths) for edit in edits_of(path)]
    return Random(seed).sample(possible, min(number, len(possible)))


def edits_of(path: Path) -> Iterator[Edit]:
    """Returns every edit of a file, in the order of its syntax tree; docstrings and annotations are left alone."""
    content = path.read_bytes()
    begins = [0]
    for line in content.splitlines(keepends=True):
        begins.append(begins[-1] + len(line))

    def start(node: ast.expr | ast.stmt) -> int:
        return begins[node.lineno - 1] + node.col_offset

    def end(node: ast.expr | ast.stmt) -> int:
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        return begins[node.end_lineno - 1] + node.end_col_offset

    def between(left: ast.expr, right: ast.expr, old: str, new: str) -> Iterator[Edit]:
        place = content.find(old.encode(), end(left), start(right))
        if place >= 0:
            yield Edit(path, place, place + len(old), content.count(b"\n", 0, place) + 1, new)

    def whole(node: ast.expr | ast.stmt, new: str) -> Edit:
        return Edit(path, start(node), end(node), node.lineno, new)

    def source(node: ast.expr) -> str:
        return content[start(node) : end(node)].decode()

    for node in _executed(ast.parse(content)):
        if isinstance(node, ast.BinOp) and type(node.op) in BINARY:
            yield from between(node.left, node.right, *BINARY[type(node.op)])
        elif isinstance(node, ast.Compare):
            for left, op, right in zip([node.left, *node.comparators], node.ops, node.comparators, strict=False):
                yield from between(left, right, *COMPARED[type(op)])
        elif isinstance(node, ast.BoolOp):
            yield from between(node.values[0], node.values[1], *JOINED[type(node.op)])
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, (ast.USub, ast.Not)):
            yield whole(node, source(node.operand))
        elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
            yield whole(node, str(not node.value))
        elif isinstance(node, ast.Constant) and isinstance(node.value, (int, float)):
            yield whole(node, str(node.value + 1) if isinstance(node.value, int) else repr(node.value * 1.5 or 1.0))
        elif isinstance(node, (ast.If, ast.While, ast.IfExp)):
            yield whole(node.test, f"(not ({source(node.test)}))")
        elif isinstance(node, (ast.AugAssign, ast.Expr)):
            yield whole(node, "pass")


def _executed(node: ast.AST) -> Iterator[ast.AST]:
    """Walks a tree without what has no effect when it runs: docstrings and annotations."""
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if not isinstance(child, ast.AST):
                continue
            if isinstance(child, ast.Expr) and isinstance(child.value, (ast.Constant, ast.Yield)):
                continue
            yield child
            yield from _executed(child)
