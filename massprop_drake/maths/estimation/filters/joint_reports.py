"""Rows of the log that a cycle of the joint filter gives, in the terms of the thesis's two filters."""

from __future__ import annotations

import numpy as np

from massprop_drake.maths.estimation.filter import MassReport, RotationReport
from massprop_drake.maths.estimation.joint.joint_cycle import Report
from massprop_drake.maths.kernels import kernel
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.mass_properties import MASS_RECIPROCAL, N_ROTATION


@kernel
def _scale_to_three_components(nis: float, degrees: float) -> float:
    """Scales a NIS of any degrees of freedom to a mean of three, as of three components; NaN for none."""
    return 3.0 * nis / degrees if degrees > 0.0 else nis


@kernel
def rotation_report(estimate: Array, covariance: Array, report: Report, n_gyro: int) -> RotationReport:
    """Makes the log row of rotation: estimate, 1-sigma and NIS, with the number of gyro components (three a gyro)."""
    used = report.used[:n_gyro]
    return RotationReport(
        estimate[:N_ROTATION],
        np.sqrt(np.diag(covariance))[:N_ROTATION],
        report.innovation[:3],
        report.innovation_std[:3],
        _scale_to_three_components(report.gyro_nis, report.gyro_degrees),
        bool(used.any()) and report.gyro_degrees > 0.0,
        report.incremented,
        report.coupled,
    )


@kernel
def mass_report(estimate: Array, covariance: Array, report: Report, n_gyro: int, n_accelerometer: int) -> MassReport:
    """Makes the log row of translation: 1/m, its variance and NIS; arguments as `rotation_report`."""
    used = report.used[n_gyro : n_gyro + n_accelerometer]
    return MassReport(
        float(estimate[MASS_RECIPROCAL]),
        float(covariance[MASS_RECIPROCAL, MASS_RECIPROCAL]),
        report.innovation[n_gyro : n_gyro + 3],
        report.innovation_std[n_gyro : n_gyro + 3],
        _scale_to_three_components(report.accelerometer_nis, report.accelerometer_degrees),
        bool(used.any()) and report.accelerometer_degrees > 0.0,
        False,
    )
