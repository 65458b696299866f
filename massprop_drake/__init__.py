"""Real-time mass-property estimation and jet-failure identification on the Drake systems framework.

    from massprop_drake import load_scenario, simulate
    run = simulate(load_scenario("sample_maneuver"))

Names are loaded when they are first used, so that `Estimator` needs neither Drake nor matplotlib.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    __version__: str

    from massprop_drake.display.run import Run as Run
    from massprop_drake.errors import InputError as InputError
    from massprop_drake.inputs.scenario import Scenario as Scenario
    from massprop_drake.inputs.scenario import load_scenario as load_scenario
    from massprop_drake.inputs.vehicle_file import Vehicle as Vehicle
    from massprop_drake.inputs.vehicle_file import load_vehicle as load_vehicle
    from massprop_drake.runners.estimator import Estimator as Estimator
    from massprop_drake.runners.estimator import EstimatorStep as EstimatorStep
    from massprop_drake.runners.forecast import foretell as foretell
    from massprop_drake.runners.recorded import estimate as estimate
    from massprop_drake.runners.simulate import simulate as simulate
    from massprop_drake.studies.campaign.campaign import Campaign as Campaign
    from massprop_drake.studies.design.designing import design as design
    from massprop_drake.studies.design.found import Design as Design

_HOMES = {
    "Campaign": "studies.campaign.campaign",
    "InputError": "errors",
    "design": "studies.design.designing",
    "Design": "studies.design.found",
    "estimate": "runners.recorded",
    "Estimator": "runners.estimator",
    "EstimatorStep": "runners.estimator",
    "foretell": "runners.forecast",
    "Run": "display.run",
    "Scenario": "inputs.scenario",
    "load_scenario": "inputs.scenario",
    "simulate": "runners.simulate",
    "Vehicle": "inputs.vehicle_file",
    "load_vehicle": "inputs.vehicle_file",
}

__all__ = sorted(_HOMES)  # noqa: PLE0605 (the names are those of the mapping above)


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version  # noqa: PLC0415 (slow to load)

        return version("massprop-drake")
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES, "__version__"})
