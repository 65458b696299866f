"""Commands, failures and payloads at stated times of a scenario."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from massprop_drake.errors import moment
from massprop_drake.inputs import plausible
from massprop_drake.inputs.model import Model, NotNegative, Positive, Real, Share, Text, Vector3, described
from massprop_drake.inputs.vehicle_parts import SymmetricMatrix3
from massprop_drake.inputs.yaml import FieldPath
from massprop_drake.maths.linear_algebra import Array


class ScheduledInterval(Model):
    """An interval from `start_s` to `end_s`, None: for ever, which must be later."""

    @model_validator(mode="after")
    def _require_end_after_start(self) -> Self:
        """Raises ValueError where end_s is not later than start_s."""
        timed: Any = self  # the fields have a meaning of their own in each class
        if timed.end_s is not None and timed.end_s <= timed.start_s:
            interval = f"{moment(timed.start_s)} to {moment(timed.end_s)}"
            raise ValueError(f"end_s must be later than start_s, got {interval}")
        return self


class HandControllerWindow(ScheduledInterval):
    """An interval in which a hand controller is held out of detent."""

    controller: Literal["rhc", "thc"] = described(
        ..., "rhc: rotational (discrete rate), thc: translational (acceleration)"
    )
    axis: Literal["+x", "-x", "+y", "-y", "+z", "-z"] = described(..., "body axis and direction")
    start_s: NotNegative = described(..., "leaves detent", "s", span=plausible.TIME)
    end_s: Positive = described(..., "returns to detent", "s", span=plausible.TIME)


class JetPulse(ScheduledInterval):
    """An interval in which a jet is commanded on, in a scenario with a prescribed jet schedule."""

    jet: Text = described(..., "designation")
    start_s: NotNegative = described(..., "first commanded", "s", span=plausible.TIME)
    end_s: Positive = described(..., "no longer commanded", "s", span=plausible.TIME)


class WheelPulse(ScheduledInterval):
    """An interval in which the motor of a reaction wheel gives a torque."""

    wheel: Text = described(..., "name")
    start_s: NotNegative = described(..., "first sample with it", "s", span=plausible.TIME)
    end_s: Positive = described(..., "first sample without it", "s", span=plausible.TIME)
    torque: Real = described(
        ..., "torque on the wheel; the vehicle gets the opposite", "ft-lbf | N-m", span=plausible.OUTSIDE_TORQUE
    )


class EngineBurn(ScheduledInterval):
    """An interval in which an engine burns at a level, or has its gimbal turned."""

    engine: Text = described(..., "name")
    start_s: NotNegative = described(..., "first sample with it", "s", span=plausible.TIME)
    end_s: Positive = described(..., "first sample without it", "s", span=plausible.TIME)
    level: Share = described(1.0, "share of its thrust")
    gimbal: tuple[Real, Real] = described((0.0, 0.0), "gimbal angles", "rad")


class EngineFailureBlock(ScheduledInterval):
    """A failure of an engine."""

    engine: Text = described(..., "name")
    kind: Literal["out", "level_stuck", "gimbal_1_stuck", "gimbal_2_stuck"] = described(
        ..., "out: no thrust; others: the level or angle stays where it is"
    )
    start_s: NotNegative = described(..., "first sample with it", "s", span=plausible.TIME)
    end_s: Positive | None = described(None, "first sample without it; null: never", "s", span=plausible.TIME)


class _Timed(ScheduledInterval):
    """The fields common to all jet failures."""

    jet: Text = described(..., "designation")
    start_s: NotNegative = described(..., "onset", "s", span=plausible.TIME)
    end_s: Positive | None = described(None, "when the jet recovers; null: never", "s", span=plausible.TIME)


class StuckOn(_Timed):
    """The jet fires regardless of its command."""

    kind: Literal["stuck_on"] = described(..., "kind of failure")


class StuckOff(_Timed):
    """The jet never fires."""

    kind: Literal["stuck_off"] = described(..., "kind of failure")


class Degraded(_Timed):
    """The jet produces only a fraction of its thrust."""

    kind: Literal["degraded"] = described(..., "kind of failure")
    fraction: Share = described(..., "share of thrust left")


class Leak(_Timed):
    """The jet produces a force along its direction, commanded or not."""

    kind: Literal["leak"] = described(..., "kind of failure")
    force: Positive = described(..., "additional force", "lbf | N", span=plausible.LEAK)


class Intermittent(_Timed):
    """The jet's valve fails at random, sample by sample."""

    kind: Literal["intermittent"] = described(..., "kind of failure")
    probability: Share = described(..., "probability of failing in a sample")
    level: Share = described(0.0, "thrust while it fails: 0 off, 1 on")


class Drift(_Timed):
    """The jet's thrust changes slowly."""

    kind: Literal["drift"] = described(..., "kind of failure")
    rate_per_s: Real = described(..., "change of the thrust, relative", "1/s", span=plausible.DRIFT)


Failure = Annotated[StuckOn | StuckOff | Degraded | Leak | Intermittent | Drift, Field(discriminator="kind")]


class MassJump(Model):
    """A payload that leaves the vehicle or docks with it, moving with the structure at that moment."""

    kind: Literal["release", "dock"] = described(..., "whether the payload leaves or comes")
    time_s: NotNegative = described(..., "time; it happens at the first sample not before it", "s", span=plausible.TIME)
    mass: Positive = described(..., "mass of the payload", "slug | kg", span=plausible.PAYLOAD)
    position: Vector3 = described(..., "its center of mass, vehicle frame", "ft | m", span=plausible.POSITION)
    inertia: SymmetricMatrix3 | None = described(
        None,
        "inertia about its own center of mass, body axes; null: a point mass",
        "slug-ft^2 | kg-m^2",
        span=plausible.INERTIA,
    )


def find_overlaps(field: str, windows: list[tuple[str, float, float]]) -> Iterator[tuple[FieldPath, str]]:
    """Yields path and problem of each window that overlaps an earlier one of the same axis, jet or joint."""
    for index, (name, start, end) in enumerate(windows):
        for other in range(index):
            if windows[other][0] == name and start < windows[other][2] and windows[other][1] < end:
                both = (f"{moment(begin)} to {moment(until)} s" for begin, until in ((start, end), windows[other][1:]))
                yield (
                    (field, index),
                    f"overlaps {field}[{other}] on the same axis, jet or joint ({name}): {' and '.join(both)}",
                )
                break


def jump_terms(jump: MassJump) -> tuple[float, Array, Array]:
    """Returns mass, position (3,) and inertia (3, 3) of a payload; mass and inertia are negative if it leaves."""
    sign = -1.0 if jump.kind == "release" else 1.0
    inertia = np.zeros((3, 3)) if jump.inertia is None else np.array(jump.inertia)
    return sign * jump.mass, np.array(jump.position), sign * inertia
