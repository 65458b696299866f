"""Flights of cases one after the other, in the process that is there for it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from massprop_drake.display.run import Run
from massprop_drake.inputs.scenario import Scenario, resolve_scenario
from massprop_drake.results.spool import Spool
from massprop_drake.results.summarize import add_batch_analysis
from massprop_drake.studies.campaign.measure import failing_reasons, measure_case
from massprop_drake.studies.campaign.plan import PlannedCase, case_name
from massprop_drake.studies.campaign.worker import require_shared


class Flights:
    """Data that all cases of a campaign share, loaded once.

    Args:
        setup: `base` (the scenario in full), `campaign` (its name), `times_s`, `keep`, `folder` (the campaign's) and
            `token` (see `worker.require_shared`), as JSON has them.

    Raises:
        InputError: when run folders may be kept, and the folder is not the driver's.
    """

    def __init__(self, setup: Mapping[str, Any]):
        self._base = resolve_scenario(setup["base"])
        self._setup = setup
        require_shared(setup)

    @property
    def compiled(self) -> bool:
        """True if cases use compiled kernels."""
        return self._base.execution.compiled

    def fly(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Flies one case and returns its row of results; writes its run folder where that is to be kept.

        Args:
            request: the fields of a `PlannedCase`, and `keep`: whether to keep it whatever becomes of it.
        """
        case = PlannedCase(**{name: request[name] for name in PlannedCase._fields})
        run = fly_case(case, self._base, self._setup["campaign"])
        row = measure_case(run, self._setup["times_s"])
        row["failing"] = failing_reasons(row)
        if request["keep"] or self._setup["keep"] == "all" or (self._setup["keep"] == "failing" and row["failing"]):
            folder = Path(self._setup["folder"]) / "cases" / case_name(case.case_id)
            if isinstance(run.signals, Spool) and case.record is None:  # a row needs no hindsight; a folder has it
                run.results = add_batch_analysis(run.results, run.scenario, run.signals)
            run.save(folder, pictures=False, report=False)
        return row


def fly_case(case: PlannedCase, base: Scenario, campaign: str) -> Run:
    """Simulates one case, or estimates it from its record, without the batch analysis; returns the run."""
    scenario = case.scenario(base, campaign)
    if case.record is not None:
        from massprop_drake.runners.recorded import estimate  # noqa: PLC0415 (the other cases need it not)

        return estimate(case.record, scenario)
    from massprop_drake.runners.simulate import simulate  # noqa: PLC0415 (loads Drake)

    return simulate(scenario, look_back=False)
