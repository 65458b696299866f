"""The flights that several figures share: the thesis's own runs and their variants.

All variants of the sample maneuver keep to the letter of the thesis: no covariance incrementation, no
failure detector. Failures fly with its detector: no reset of the jet logic, signatures taken as certain,
innovations corrected by (4-29) to (4-35).
"""

from __future__ import annotations

from dataclasses import replace

from reproduction.cases import CONSISTENCY, DETECTION, ESTIMATES, MOTION, PHASES, Flight

LITERAL = ("rotation.jump=none", "detector.kind=off")


def maneuver(name: str, *overrides: str, signals: tuple[str, ...] = (*ESTIMATES, *CONSISTENCY)) -> Flight:
    """Makes a flight of the sample maneuver, to the letter of the thesis but for some settings."""
    return Flight(name, "sample_maneuver", (*LITERAL, *overrides), signals)


# the thesis's own run; its printed numbers deserve more phases
HYBRID = replace(maneuver("hybrid", signals=(*ESTIMATES, *CONSISTENCY, *MOTION)), seeds=3 * PHASES)
SHORT_REQUESTS = maneuver("short_requests", "autopilot.horizon_s=0.4", signals=MOTION)  # of translations
SUBTRACTED = maneuver("subtracted", "rotation.coupling=subtract")
IGNORED = maneuver("ignored", "rotation.coupling=ignore")

EXTENDED = maneuver("extended", "rotation.filter=extended")
WITHOUT_BIAS = maneuver("without_bias", "rotation.filter=second_order_without_bias")
WITHOUT_COVARIANCE = maneuver("without_covariance", "rotation.filter=second_order_without_covariance")

CENTRIPETAL = maneuver("centripetal", "mass.compensation=transverse_centripetal")
TRANSVERSE = HYBRID
NO_COVARIANCE = maneuver("no_covariance", "mass.compensation_covariance=false")
NO_COMPENSATION = maneuver("no_compensation", "mass.compensation=none", "mass.compensation_covariance=false")

# jets selected anew for small rate errors: fewer of the samples of a translation are steady
_CLOSELY_HELD = ("autopilot.resolve_rate=0.000349065850", "autopilot.resolve_after_s=0.16")  # 0.02 deg/s
CLOSELY_HELD = maneuver("closely_held", *_CLOSELY_HELD)
CLOSELY_HELD_NONE = maneuver(
    "closely_held_none", *_CLOSELY_HELD, "mass.compensation=none", "mass.compensation_covariance=false"
)
CLOSELY_HELD_T = maneuver("closely_held_t", *_CLOSELY_HELD, "mass.compensation_covariance=false")

MIDDLE = HYBRID
LEFT = maneuver("left", "sensors.accelerometer=acc1")


def combined(rule: str, *overrides: str, name: str = "") -> Flight:
    """Makes a flight whose three accelerometers are combined by a rule."""
    return maneuver(name or rule, f"sensors.combine.accelerometers={rule}", *overrides)


SERIAL = combined("serial")
STACKED = combined("serial", "sensors.combine.correlated=true", name="stacked")
WEIGHTED = combined("weighted_average")
AVERAGE = combined("average")
MID_VALUE = combined("mid_value")

# all quantizers at the same marks: nothing is left to chance, so once is enough
_EQUAL = "sensors.quantizer_phase=equal"
SINGLE_EQUAL = replace(maneuver("single_equal", _EQUAL), seeds=1)
WEIGHTED_EQUAL = replace(combined("weighted_average", _EQUAL, name="weighted_equal"), seeds=1)

INCREMENTED = maneuver("incremented", "rotation.jump=covariance_increment")
INCREMENTED_EARLY = maneuver("incremented_early", "rotation.jump=covariance_increment", "rotation.jump_threshold=11.34")

# other maneuvers of the same kinds, in another order and rhythm
_OTHER = (
    "maneuver=["
    "{controller: rhc, axis: -z, start_s: 1, end_s: 3},"
    "{controller: rhc, axis: +x, start_s: 5, end_s: 8},"
    "{controller: thc, axis: -y, start_s: 11, end_s: 13},"
    "{controller: rhc, axis: +y, start_s: 15, end_s: 18},"
    "{controller: thc, axis: +z, start_s: 20, end_s: 22},"
    "{controller: rhc, axis: -x, start_s: 24, end_s: 27},"
    "{controller: thc, axis: +x, start_s: 29, end_s: 31},"
    "{controller: rhc, axis: -x, start_s: 33, end_s: 37},"
    "{controller: rhc, axis: -y, start_s: 33, end_s: 41},"
    "{controller: rhc, axis: +z, start_s: 37, end_s: 45}]"
)
_TRANSLATION_FIRST = (
    "maneuver=["
    "{controller: thc, axis: +z, start_s: 1, end_s: 3},"
    "{controller: rhc, axis: -z, start_s: 5, end_s: 8},"
    "{controller: thc, axis: -y, start_s: 11, end_s: 13},"
    "{controller: rhc, axis: +y, start_s: 15, end_s: 18},"
    "{controller: rhc, axis: +x, start_s: 20, end_s: 23},"
    "{controller: thc, axis: +x, start_s: 26, end_s: 28},"
    "{controller: rhc, axis: -x, start_s: 31, end_s: 35},"
    "{controller: rhc, axis: -y, start_s: 31, end_s: 39},"
    "{controller: rhc, axis: +z, start_s: 35, end_s: 43}]"
)
OTHER = maneuver("other", _OTHER)
OTHER_IGNORED = maneuver("other_ignored", _OTHER, "rotation.coupling=ignore")
OTHER_EXTENDED = maneuver("other_extended", _OTHER, "rotation.filter=extended")
OTHER_NONE = maneuver("other_none", _OTHER, "mass.compensation=none", "mass.compensation_covariance=false")
TRANSLATION_FIRST = maneuver("translation_first", _TRANSLATION_FIRST)
TRANSLATION_FIRST_INCREMENTED = maneuver(
    "translation_first_incremented", _TRANSLATION_FIRST, "rotation.jump=covariance_increment"
)

_DETECTOR = (
    "detector.reconfigure_after=null",
    "detector.signature_uncertainty=false",
    "detector.unexplained_limit=null",
    "detector.on_detection=correct_thesis",
    "duration_s=58",
)


def failure(name: str) -> Flight:
    """Makes a flight of a bundled failure with the thesis's detector; signals are kept from 45 s on."""
    return Flight(name, name, _DETECTOR, DETECTION, from_s=45.0)


STUCK_ON = replace(failure("stuck_on_29"), signals=(*DETECTION, *ESTIMATES))
# the same with a reset of the jet logic after two alarms in a row
STUCK_ON_RESET = Flight(
    "stuck_on_29_reset", "stuck_on_29", (*_DETECTOR, "detector.reconfigure_after=2"), ESTIMATES, from_s=45.0
)
# the same with every too large innovation taken for a jump of the mass properties, at the thesis's 1 %
STUCK_ON_JUMP = Flight(
    "stuck_on_29_jump",
    "stuck_on_29",
    (
        "detector.kind=off",
        "rotation.jump=covariance_increment",
        "rotation.jump_threshold=11.34",
        "mass.jump=single_sample",
        "mass.jump_false_alarm_rate=0.01",
        "duration_s=58",
    ),
    ESTIMATES,
    from_s=45.0,
)
STUCK_OFF = failure("stuck_off_11")
VERNIER = failure("vernier_stuck_on_39")
LEAK = failure("leak_24")
UNSEEN_LEAK = failure("leak_27")
