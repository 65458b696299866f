"""Vehicles: jets, nominal mass properties and sensors, read from YAML and validated."""

from __future__ import annotations

from pathlib import Path

from pydantic import model_validator

from massprop_drake.inputs.kinds import bundled_files
from massprop_drake.inputs.model import field_validation_error, validate_data
from massprop_drake.inputs.plausible import Finding
from massprop_drake.inputs.vehicle_checks import (
    component_problems,
    frame_problems,
    impossible_entries,
    tank_problems,
    vehicle_findings,
)
from massprop_drake.inputs.vehicle_fields import VehicleFields
from massprop_drake.inputs.yaml import open_document


class Vehicle(VehicleFields):
    """A vehicle as the estimators know it: nominal mass properties, jets and sensors.

    The vehicle frame has its origin fixed in the structure and the body axes' directions.
    """

    @model_validator(mode="after")
    def _require_consistent_vehicle(self) -> Vehicle:
        """Raises ValidationError with the problems of the first of four checks that finds any."""
        for find in (frame_problems, component_problems, tank_problems, impossible_entries):
            if problems := list(find(self)):
                raise field_validation_error(problems)
        return self

    @property
    def doubts(self) -> list[Finding]:
        """Doubtful entries of the vehicle, more likely a slip than meant."""
        return [finding for finding in vehicle_findings(self) if not finding.impossible]


def bundled_vehicles() -> list[str]:
    """Lists the names of the bundled vehicles."""
    return bundled_files("vehicle")


def load_vehicle(vehicle: str | Path) -> Vehicle:
    """Loads a bundled vehicle by name, or one from a YAML file.

    Args:
        vehicle: a name that `massprop list` shows, or the path of a file.

    Raises:
        InputError: when there is none of that name, or its data are wrong; the message says where.
    """
    document, _ = open_document(vehicle, "vehicle")
    return validate_data(Vehicle, document.data, document)
