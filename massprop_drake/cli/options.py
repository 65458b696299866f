"""Options that commands have in common."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

import typer

from massprop_drake.cli.completion import make_completer

Flight = Annotated[
    str,
    typer.Argument(
        help="A bundled scenario, a YAML file, or an earlier run's folder.", autocompletion=make_completer("scenario")
    ),
]
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON alone on standard output.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")]
View = Annotated[bool, typer.Option("--view", help="Write replay.html, the run in three dimensions, too.")]
Report = Annotated[bool, typer.Option("--report/--no-report", help="Write report.html, or not.")]
Force = Annotated[
    bool, typer.Option("--force", help="Keep what is there as <name>.1, <name>.2, ... instead of refusing it.")
]
Figures = Annotated[bool, typer.Option("--figures/--no-figures", help="Draw the figures, or not, which is faster.")]
Guaranteed = Annotated[
    bool, typer.Option("--intervals", help="Add the intervals of mass properties that quantized readings guarantee.")
]
Compiled = Annotated[
    bool,
    typer.Option("--compiled", help="Use compiled kernels, and to simulate the plain loop; needs the extra `fast`."),
]
Overrides = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Replaces any field; VALUE is read as YAML. Repeatable."),
]


class Schema(StrEnum):
    """The kinds of files whose keys can be shown."""

    vehicle = "vehicle"
    scenario = "scenario"
    campaign = "campaign"
    map = "map"
