"""Sensors and autopilot in a scenario: packages in use, their true errors, and how jets and wheels are flown."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import model_validator

from massprop_drake.inputs import plausible
from massprop_drake.inputs.model import Flag, Model, NotNegative, Positive, Real, Text, Vector3, Whole, described

_DEGREE = np.pi / 180.0


class VibrationTone(Model):
    """A vibration of the structure as the sensors of a package feel it; estimators and autopilot do not know of it."""

    frequency_hz: Positive = described(
        ..., "frequency; from half the sample frequency on it is aliased", "Hz", span=plausible.TONE
    )
    amplitude: Vector3 = described(
        ..., "amplitude per axis, of rate or acceleration; phases are drawn", "rad/s | ft/s^2 | m/s^2"
    )


class SensorErrors(Model):
    """The true errors of one sensor package, unknown to the estimators, in the order in which they act on a signal."""

    sensor: Text = described(..., "name of a gyro or accelerometer package")
    vibration: tuple[VibrationTone, ...] = described((), "vibration of the structure at the sensor")
    scale_factor: Vector3 = described((0.0, 0.0, 0.0), "per axis: reading = (1 + this) x truth", span=plausible.SCALE)
    bandwidth_hz: Positive | None = described(
        None, "corner of a first-order low-pass before sampling; null: unlimited", "Hz", span=plausible.BANDWIDTH
    )
    bias: Vector3 = described((0.0, 0.0, 0.0), "constant bias of rate or acceleration", "rad/s | ft/s^2 | m/s^2")
    bias_random_walk: NotNegative = described(
        0.0, "random walk of the bias, 1-sigma after 1 s", "rad/s/sqrt(s) | ft/s^2/sqrt(s) | m/s^2/sqrt(s)"
    )
    noise_std: NotNegative | None = described(None, "white noise, 1-sigma; null: the vehicle's", "rad/s | ft/s | m/s")
    quantum: NotNegative | None = described(None, "step of a reading; null: the vehicle's", "rad/s | ft/s | m/s")
    delay_samples: Whole = described(0, "delay of readings", ge=0, le=100)


_RULES = Literal["single", "most_accurate", "mid_value", "average", "weighted_average", "serial"]
_RULE = (
    "single: the package in use, else the next; most_accurate: least covariance; mid_value: the "
    "median of each component; average; weighted_average: by covariance; serial: one update after the"
    " other"
)


class CombineBlock(Model):
    """Use of several packages of one kind by the filters."""

    gyros: _RULES = described("single", _RULE)
    accelerometers: _RULES = described("single", _RULE)
    correlated: Flag = described(
        False, "whether averages of accelerometers account for correlated errors; serial then is one stacked update"
    )


class SensorsBlock(Model):
    """The sensors."""

    quantizer_phase: Literal["seeded", "equal"] = described(
        "seeded", "seeded: random offset of each component's marks; equal: none"
    )
    gyro: Text | None = described(None, "package in use; null: the first")
    accelerometer: Text | None = described(None, "package in use; null: the vehicle's preferred one")
    combine: CombineBlock = described(
        CombineBlock(), "redundant packages, with filter: thesis; joint uses all of them as they are"
    )
    errors: tuple[SensorErrors, ...] = described((), "errors beyond the vehicle file's quanta and noise")


class JetSelectionBlock(Model):
    """Flight of the on-times that the autopilot's linear program selects."""

    output: Literal["cycles", "on_time"] = described(
        "cycles", "cycles: whole sample periods; on_time: in steps of the valve's clock, of a vehicle with on-times"
    )
    below_minimum: Literal["accumulate", "drop"] = described(
        "accumulate",
        "treatment of on-times below a jet's minimum with output: on_time; accumulate: until they reach it",
    )


class WheelControlBlock(Model):
    """Reaction wheels that hold attitude and follow rates, and are unloaded by jets."""

    rate_gain: Positive = described(
        1.0,
        "wheel torque per rate error and inertia; four times hold_gain damps critically",
        "1/s",
        span=plausible.GAIN,
    )
    unload_above: Real | None = described(
        None, "share of its largest speed at which a wheel has jets unload all wheels; null: never", gt=0.0, le=1.0
    )
    unload_below: Real = described(0.2, "share below which unloading ends", ge=0.0, lt=1.0)
    unload_rate: Positive | None = described(
        None,
        "largest rate change asked of jets at a time to unload; null: 1.5 times rate_deadband, below "
        "which nothing is asked",
        "rad/s",
        span=plausible.RATE,
    )

    @model_validator(mode="after")
    def _require_unload_band(self) -> WheelControlBlock:
        """Raises ValueError where unload_below is not less than unload_above."""
        if self.unload_above is not None and self.unload_below >= self.unload_above:
            raise ValueError(
                f"unload_below must be less than unload_above, got {self.unload_below:g} and {self.unload_above:g}"
            )
        return self


class FiringTestBlock(Model):
    """Firings that are designed and flown when the estimators leave a question open."""

    when: Literal["group", "target"] = described(..., "group: to isolate a failed jet; target: to reach 1-sigmas")
    targets: dict[Text, Text] = described({}, "with when: target, 1-sigma by name, as for `massprop design`")
    force: Text = described("5%", "with when: group, force by which a suspect may fail, likewise")
    limits: dict[Text, Text] = described(
        {}, "limits of one test: rate, angle, displacement, propellant, time; likewise"
    )
    without: tuple[Text, ...] = described((), "jets not to be fired")
    patience_s: Positive = described(
        2.0, "how long the question must stand, and pause between tests", "s", span=plausible.TIME
    )

    @model_validator(mode="after")
    def _require_matching_targets(self) -> FiringTestBlock:
        """Raises ValueError where `when: target` comes without targets, or targets without it."""
        if (self.when == "target") != bool(self.targets):
            raise ValueError("targets go with when: target, which needs at least one")
        return self


class AutopilotBlock(Model):
    """Manual modes of the thesis: discrete rate, attitude hold, acceleration."""

    engaged: bool | None = described(
        None, "whether it flies; with a `jet_schedule` it holds attitude between pulses; null: only without one"
    )
    mass_properties: Literal["nominal", "estimated"] = described(
        "nominal", "source for activity vectors; estimated: once converged"
    )
    jet_kinds: tuple[Text, ...] | None = described(
        None, "kinds of jets that may be selected; null: `primary`, else all", min_length=1
    )
    jet_selection: JetSelectionBlock = described(JetSelectionBlock(), "how selected on-times are flown")
    test_firing: FiringTestBlock | None = described(None, "firings that settle what the estimators leave open")
    wheels: WheelControlBlock | None = described(
        None, "attitude control by wheels; null: they stand, or follow `wheel_schedule`"
    )
    discrete_rate: Positive = described(
        0.5 * _DEGREE, "rate commanded by the rotational controller", "rad/s", span=plausible.RATE
    )
    hold_gain: NotNegative = described(0.15, "commanded rate per attitude error in hold", "1/s", span=plausible.GAIN)
    hold_rate_limit: NotNegative = described(
        0.1 * _DEGREE, "largest rate commanded in hold", "rad/s", span=plausible.RATE
    )
    capture_rate: Positive = described(
        0.05 * _DEGREE, "rate below which an axis in detent begins to hold attitude", "rad/s", span=plausible.RATE
    )
    rate_deadband: Positive = described(0.02 * _DEGREE, "rate error that is corrected", "rad/s", span=plausible.RATE)
    acceleration: Positive = described(
        0.5, "acceleration commanded by the translational controller", "ft/s^2 | m/s^2", span=plausible.ACCELERATION
    )
    horizon_s: Positive = described(2.0, "time for which a translation is requested", "s", span=plausible.TIME)
    resolve_rate: Positive = described(
        0.2 * _DEGREE, "in a translation, rate error that causes a new selection", "rad/s", span=plausible.RATE
    )
    resolve_after_s: NotNegative = described(
        0.4, "least time between two selections in a translation", "s", span=plausible.TIME
    )
    gimbal_bandwidth: NotNegative = described(
        0.0,
        "bandwidth with which gimbals hold zero rate during burns, beside their schedule; 0: schedule alone",
        "rad/s",
        span=plausible.GAIN,
    )
