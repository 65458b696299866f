"""Detectors of failed jets, a file per variant, and the registry that scenarios name them by."""

from __future__ import annotations

from massprop_drake.maths.estimation.detector import Detector
from massprop_drake.maths.estimation.detectors import cglr, cusum, thrust_factors
from massprop_drake.maths.estimation.faults import hypothesis_filter as faults

DETECTORS: dict[str, Detector] = {
    "cglr": cglr.DETECTOR,
    "cusum": cusum.DETECTOR,
    "hypotheses": faults.DETECTOR,
    "thrust_factors": thrust_factors.DETECTOR,
}
