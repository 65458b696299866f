"""Campaigns at the command line: `massprop campaign ...`.

Exit statuses besides the usual ones: 3 when a gate fails, 4 when cases failed to run, whatever the gates say of the
rest.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from massprop_drake.cli import completion
from massprop_drake.cli.options import Compiled, Force, Json, Overrides, Quiet
from massprop_drake.cli.streams import note, say
from massprop_drake.errors import InputError

if TYPE_CHECKING:
    from massprop_drake.studies.campaign.campaign import Campaign
    from massprop_drake.studies.campaign.conclusion import Conclusion

app = typer.Typer(
    help="Flies many cases of a scenario, and reports what becomes of them.",
    no_args_is_help=True,
    rich_markup_mode="markdown",
)

GATE_FAILED, NOT_ALL_RAN = 3, 4  # exit statuses
_PAGE, _SUMMARY = "campaign.html", "summary.json"
_COMPARISON = "campaigns"  # kind of page

Source = Annotated[
    str,
    typer.Argument(
        help="A bundled campaign, a YAML file, or a campaign's folder.",
        autocompletion=completion.make_completer("campaign"),
    ),
]
Folder = Annotated[Path, typer.Argument(help="A campaign's folder.")]
Out = Annotated[Path | None, typer.Option(help="Folder to write; default runs/<name>.")]


@app.command(epilog="Example: `massprop campaign plan every_jet --out runs/every_jet`")
def plan(
    campaign: Source,
    out: Out = None,
    overrides: Overrides = None,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Draws every case of a campaign and writes them down, without flying any."""
    from massprop_drake.cli import show

    loaded = _load_campaign(campaign, overrides)
    target = _output_folder(loaded, out)
    planned = loaded.plan(target, force=force)
    _print_warnings(loaded, quiet=quiet)
    cases = planned.planned()
    if as_json:
        show.print_json([case._asdict() for case in cases])
    elif not quiet:
        cells = len({case.cell for case in cases})
        drawn = ", ".join(quantity.label for quantity in loaded.spec.quantities) or "nothing"
        say(f"{len(cases)} cases of '{loaded.spec.base.name}', {cells} of each draw; drawn: {drawn}")
        say(f"plan: {target}/plan.parquet")


@app.command(epilog="Example: `massprop campaign run healthy_maneuver --workers 4 --out runs/healthy`")
def run(
    context: typer.Context,
    campaign: Source,
    out: Out = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes on this machine; default its cores.")] = None,
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="A Dask scheduler, such as tcp://10.0.0.1:8786.")
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with what the folder holds.")] = False,
    only: Annotated[
        list[int] | None, typer.Option(metavar="CASE", help="Fly this case alone and keep its folder. Repeatable.")
    ] = None,
    overrides: Overrides = None,
    compiled: Compiled = False,
    report: Annotated[bool, typer.Option("--report/--no-report", help="Write campaign.html, or not.")] = True,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Flies the cases of a campaign that have not been flown yet."""
    from massprop_drake.cli.progress import Progress
    from massprop_drake.results.folder import require_files
    from massprop_drake.studies.processes import call_in_process

    if workers is not None and scheduler is not None:
        raise InputError("give either --workers or --scheduler, not both: a scheduler has its own workers")
    loaded = _load_campaign(campaign, [*(overrides or []), *(["execution.compiled=true"] if compiled else [])])
    target = _output_folder(loaded, out)
    if report and not only and not force and target.is_dir():
        require_files(target, [_PAGE, _SUMMARY])
    context.obj.watch(
        target / _SUMMARY,
        f"the report is saved in {target}/",
        f"cases flown so far are kept in {target}/; the same command with --resume goes on from there",
    )
    _print_warnings(loaded, quiet=quiet)
    if loaded.spec.base.execution.compiled and not quiet and scheduler is None:
        from massprop_drake.maths.kernels import has_cached_kernels, has_compiler

        if has_compiler() and not has_cached_kernels():
            note("kernels are compiled by each worker for its first case, which takes a minute or two, once")
    shown = not (as_json or quiet)
    with Progress(f"flying {loaded.spec.file.name}", 1.0, shown=shown) as progress:
        flown = loaded.run(
            target,
            workers=workers,
            scheduler=scheduler,
            resume=resume,
            only=only or (),
            force=force,
            progress=lambda done, total: progress(done / total),
            dashboard=(lambda address: note(f"Dask's dashboard is at {address}")) if shown else None,
        )
    if only:
        _print_kept_cases(flown, only, as_json=as_json, quiet=quiet)
    else:
        from massprop_drake.studies.campaign.conclusion import make_conclusion

        conclusion = call_in_process(
            make_conclusion, target, with_page=report
        )  # thousands of rows leave this process's memory as it is
        _report_conclusion(conclusion, target, force=force, as_json=as_json, quiet=quiet)


@app.command(epilog="Example: `massprop campaign status runs/healthy`")
def status(folder: Folder, as_json: Json = False) -> None:
    """Says how far a campaign is and how its cases ended, also while it runs."""
    from massprop_drake.cli import show
    from massprop_drake.studies.campaign import counts
    from massprop_drake.studies.campaign.campaign import Campaign

    progress = Campaign.load(folder).status()
    if as_json:
        cells = [{"settings": dict(settings), **case_counts._asdict()} for _, settings, case_counts in progress.cells]
        show.print_json({**progress.counts._asdict(), "cells": cells})
    else:
        for sentence in (
            counts.progress_text(progress.counts),
            counts.failed_to_run_text(progress.counts),
            *counts.outcome_sentences(progress),
        ):
            if sentence:
                say(sentence)


@app.command(epilog="Example: `massprop campaign report runs/healthy`")
def report(folder: Folder, force: Force = False, as_json: Json = False, quiet: Quiet = False) -> None:
    """Writes the report of a campaign again from the cases flown so far, and judges its gates."""
    from massprop_drake.studies.campaign.conclusion import make_conclusion

    _report_conclusion(make_conclusion(folder, with_page=True), folder, force=force, as_json=as_json, quiet=quiet)


@app.command(epilog="Example: `massprop campaign compare runs/cglr runs/cusum --out cglr_cusum.html`")
def compare(
    folders: Annotated[
        list[Path], typer.Argument(help="Campaigns' folders with the same draws; or one, for the cells of its sweep.")
    ],
    out: Annotated[Path, typer.Option(help="File to write.")] = Path("compare.html"),
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Compares campaigns with the same draws, case by case."""
    from massprop_drake.cli import show
    from massprop_drake.results.folder import require_file, write_page
    from massprop_drake.studies.campaign import compare as comparison

    require_file(out, _COMPARISON, force=force, reads=folders)
    write_page(out, comparison.page(folders), _COMPARISON, force=force, reads=folders)
    if as_json:
        show.print_json(comparison.summary(folders))
    elif not quiet:
        show.print_differences(comparison.summary(folders))
        say(f"comparison: {out}")


def _load_campaign(source: str, overrides: list[str] | None) -> Campaign:
    """Loads a campaign by name, file or folder, with overrides."""
    from massprop_drake.studies.campaign.campaign import Campaign

    return Campaign.load(source, overrides or ())


def _output_folder(campaign: Campaign, out: Path | None) -> Path:
    """Returns the folder to write: `--out`, the campaign's own, or `runs/<name>`."""
    return out or campaign.folder or Path("runs") / campaign.spec.file.name


def _print_warnings(campaign: Campaign, *, quiet: bool) -> None:
    """Prints warnings on doubtful entries of a campaign; if quiet, none."""
    for advice in () if quiet else campaign.advice():
        note(f"warning: {advice}")


def _print_kept_cases(campaign: Campaign, case_ids: list[int], *, as_json: bool, quiet: bool) -> None:
    """Prints the folders of cases flown by `--only`; exits with a status if any failed to run."""
    from massprop_drake.cli import show

    folders = {case_id: campaign.case_folder(case_id) for case_id in case_ids}
    failed = [case_id for case_id, path in folders.items() if not path.is_dir()]
    if as_json:
        show.print_json({str(case_id): None if case_id in failed else str(path) for case_id, path in folders.items()})
    for case_id, path in folders.items():
        if case_id in failed:
            note(f"case {case_id} failed to run: {campaign.reason(case_id)}")
        elif not (quiet or as_json):
            say(f"case {case_id}: {path}/; 'massprop run {path}' flies it again")
    if failed:
        raise typer.Exit(NOT_ALL_RAN)


def _report_conclusion(conclusion: Conclusion, folder: Path, *, force: bool, as_json: bool, quiet: bool) -> None:
    """Writes the report, prints its verdict, and exits with a status if a case failed to run or a gate fails."""
    from massprop_drake.cli import show
    from massprop_drake.results.folder import write_files

    summary = conclusion.summary
    if conclusion.page is not None:
        files = {_SUMMARY: show.json_text(summary).encode(), _PAGE: conclusion.page.encode()}
        write_files(folder, files, force=force)
    if as_json:
        show.print_json(summary)
    elif not quiet:
        show.print_verdict(conclusion.verdict)
        if conclusion.page is not None:
            say(f"report: {folder / _PAGE}")
    if summary["failed_to_run"]:
        raise typer.Exit(NOT_ALL_RAN)
    if not summary["passed"]:
        raise typer.Exit(GATE_FAILED)
