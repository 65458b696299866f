"""Fields of a scenario: one case to simulate, and how to estimate in it.

Every variant of a method is a field here, never an edit of code. Angles are radians.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from massprop_drake.inputs.estimation_blocks import (
    DetectorBlock,
    EstimationBlock,
    FaultsBlock,
    HypothesesBlock,
    JointBlock,
    MassBlock,
    RotationBlock,
)
from massprop_drake.inputs.model import Flag, Model, Real, Text, Whole, described
from massprop_drake.inputs.moving import MovingPart, join_parts
from massprop_drake.inputs.onboard_blocks import AutopilotBlock, SensorsBlock
from massprop_drake.inputs.scheduled import (
    EngineBurn,
    EngineFailureBlock,
    Failure,
    HandControllerWindow,
    JetPulse,
    MassJump,
    WheelPulse,
)
from massprop_drake.inputs.true_blocks import MultibodyBlock, PlantBlock
from massprop_drake.inputs.vehicle_file import Vehicle, load_vehicle

USUAL_VEHICLE = "orbiter"
_LONGEST_NAME = 200  # characters; those of a folder's name are limited


class ExecutionBlock(Model):
    """Computation of a case; the engine changes no bit of a result, compiled code the last ones."""

    engine: Literal["diagram", "loop"] = described(
        "diagram",
        "diagram: Drake's simulator; loop: the same functions in a plain loop, faster, for a stepped "
        "plant without wheels and engines",
    )
    compiled: Flag = described(
        False, "whether kernels are compiled by numba, extra `fast`; results differ by rounding alone"
    )


class ScenarioFields(Model):
    """Fields of a scenario, each sound by itself."""

    name: Text = described(
        "scenario",
        "short name, also of the run's folder",
        pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$",
        max_length=_LONGEST_NAME,
    )
    description: Text = described("", "one line")
    vehicle: Text | Vehicle = described(
        USUAL_VEHICLE, "bundled vehicle, file relative to this one, or a vehicle's data"
    )
    moving: tuple[MovingPart, ...] = described(
        (), "parts that move inside, as in a vehicle's file, besides those of the vehicle"
    )
    duration_s: Real = described(50.0, "length of the run", "s", gt=0.0, le=1e6)
    seed: Whole = described(0, "seed of all random draws", ge=0, lt=2**63)
    maneuver: tuple[HandControllerWindow, ...] = described((), "hand-controller windows, flown by the autopilot")
    jet_schedule: tuple[JetPulse, ...] = described((), "prescribed jet commands")
    wheel_schedule: tuple[WheelPulse, ...] = described((), "prescribed torques of reaction wheels")
    engine_schedule: tuple[EngineBurn, ...] = described((), "prescribed levels and gimbal angles of engines")
    plant: Annotated[PlantBlock | MultibodyBlock, Field(discriminator="kind")] = described(
        PlantBlock(), "the true vehicle"
    )
    sensors: SensorsBlock = described(SensorsBlock(), "packages in use, and their true errors")
    autopilot: AutopilotBlock = described(AutopilotBlock(), "attitude hold and hand controllers, by jets or wheels")
    estimation: EstimationBlock = described(EstimationBlock(), "the filter and its start")
    rotation: RotationBlock = described(RotationBlock(), "filter for inverse inertia and center of mass")
    mass: MassBlock = described(MassBlock(), "filter for the mass reciprocal")
    joint: JointBlock = described(JointBlock(), "the filter of `estimation.filter: joint`")
    detector: DetectorBlock = described(
        HypothesesBlock(),
        "detection of failures: hypotheses or off with estimation.filter: joint; cglr, cusum or off with "
        "thesis; thrust_factors or off with pose; the first unless named",
    )
    faults: FaultsBlock = described(FaultsBlock(), "priors of faults, with estimation.filter: joint")
    failures: tuple[Failure, ...] = described((), "failures of jets")
    engine_failures: tuple[EngineFailureBlock, ...] = described((), "failures of engines")
    jumps: tuple[MassJump, ...] = described((), "payloads released or docked")
    execution: ExecutionBlock = described(ExecutionBlock(), "how a run is computed")

    def __repr__(self) -> str:
        counts = {"failures": len(self.failures), "jumps": len(self.jumps)}
        happens = "".join(f", {count} {kind[: -1 if count == 1 else None]}" for kind, count in counts.items() if count)
        return (
            f"<Scenario '{self.name}': vehicle '{self.vehicle_data.name}', {self.duration_s:g} s, seed {self.seed}, "
            f"filter {self.estimation.filter}, detector {self.detector.kind}{happens}>"
        )

    __str__ = __repr__

    @property
    def vehicle_data(self) -> Vehicle:
        """Vehicle, loaded if the scenario only names it, with the parts that move inside."""
        vehicle = self.vehicle if isinstance(self.vehicle, Vehicle) else load_vehicle(self.vehicle)
        if not self.moving:
            return vehicle
        return vehicle.model_copy(update={"moving": join_parts(vehicle.moving, self.moving)})

    @property
    def open_loop(self) -> bool:
        """True if no autopilot flies."""
        engaged = self.autopilot.engaged
        return bool(self.jet_schedule) if engaged is None else not engaged

    @property
    def process_noise_std(self) -> tuple[float, ...]:
        """1-sigma of the change of the ten parameters per sample, as the blocks of their filters say."""
        return (*self.rotation.process_noise_std, self.mass.process_noise_std)
