"""The command line of the reproduction, and the tables that it prints."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from massprop_drake.cli import show
from massprop_drake.cli.options import Force, Json, Quiet
from massprop_drake.cli.progress import Progress
from massprop_drake.cli.terminal import Terminal
from reproduction.report import Reproduced, as_data, label, summary_line

app = typer.Typer(
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    context_settings={"help_option_names": ["-h", "--help"]},
)
_VERDICT_STYLES = {"holds": "green", "holds within spread": "cyan", "differs": "yellow"}
# share of the width by heading; None: as wide as it needs
_COLUMNS = {"claim": 4, "source": None, "its words": 4, "expected": 3, "measured": 3, "verdict": 3}


@app.command(epilog="Example: `python -m reproduction --only fig_5_6 --only table_5_3`")
def reproduce(
    context: typer.Context,
    out: Annotated[Path, typer.Option(help="Folder to write; goes on with what it holds.")] = Path("runs/reproduction"),
    only: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="A figure or table alone, such as fig_5_6. Repeatable.")
    ] = None,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Reruns every figure and table of the thesis and says of each claim whether it holds."""
    context.obj.watch(
        out / "reproduction.html",
        f"the reproduction is saved in {out}/",
        f"finished runs are kept in {out}/, and the same command goes on from there",
    )

    from reproduction import catalog
    from reproduction.reproduce import reproduce as rerun

    entries = catalog.select_entries(only)
    with Progress("reproducing the thesis", 1.0, shown=not (as_json or quiet)) as progress:
        results = rerun(entries, out, lambda done, total: progress(done / total), force=force)
    if as_json:
        show.print_json(as_data(results))
    elif not quiet:
        _print(results, out)


def _print(results: Iterable[Reproduced], folder: Path) -> None:
    """Prints a table of claims per entry, and how many of them hold."""
    results, console = list(results), Terminal(160)
    for result in results:
        title = f"{label(result.entry)}: {result.entry.title}"
        table = Table(title=title, title_justify="left", header_style="bold", expand=True)
        for heading, share in _COLUMNS.items():
            table.add_column(heading, ratio=share)
        for outcome in result.outcomes:
            why = f": {outcome.why}" if outcome.why else ""
            verdict = console.words((outcome.verdict, _VERDICT_STYLES[outcome.verdict]), why)
            claim = outcome.claim
            table.add_row(claim.text, claim.source, claim.thesis, claim.expected, outcome.measured, verdict)
        console.print(table)
    console.say(summary_line(results))
    console.say(f"files: {folder}/reproduction.html, reproduction.md, figures/")
