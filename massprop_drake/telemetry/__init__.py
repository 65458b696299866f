"""Recorded telemetry, its format and its quality."""

from massprop_drake.inputs import renamed

__getattr__ = renamed.attributes(
    __name__,
    {
        name: f"{__name__}.reader.{name}"
        for name in ("Reader", "Record", "Rows", "check", "columns", "scenario_name", "vehicle_scenario", "write_csv")
    },
)
