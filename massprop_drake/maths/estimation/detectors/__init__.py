"""Detectors of failed jets, a file per variant, and the registry that scenarios name them by."""

from __future__ import annotations

from massprop_drake.maths.estimation.detector import Detector
from massprop_drake.maths.estimation.detectors import cglr, cusum, hypotheses, thrust_factors

DETECTORS: dict[str, Detector] = {
    "cglr": cglr.DETECTOR,
    "cusum": cusum.DETECTOR,
    "multi_hypothesis": hypotheses.DETECTOR,
    "thrust_factors": thrust_factors.DETECTOR,
}
