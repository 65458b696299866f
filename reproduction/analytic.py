"""Calculations on failed jets that need no flight: the noise-free tests and the sweep of soft failures.

All at the true mass properties of table 5-2 and with the sensors of section 5.1: the covariance of one
sample's innovations is that of the sensors alone, blkdiag(R^zeta, R^z), and the failure acts over the
whole sample. Arguments and margins without noise grow with the square of the force.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.inputs.params import unit_wrenches
from massprop_drake.maths.estimation.detectors.jet_tests import Isolation, JetTests, isolate, jet_tests, signatures
from reproduction.measures import orbiter

Array = NDArray[np.float64]

FORCES = np.arange(5.0, 51.0, 5.0)  # lbf, of section 5.3.2
MARGIN = 6.0
_SAMPLES = 40  # of each jet and force, per seed


class Setting(NamedTuple):
    """Constants of the tests: signatures per lbf, shape (44, 6), information (6, 6), clusters, quanta (6,)."""

    coefficients: Array
    information: Array
    clusters: NDArray[np.int_]
    quanta: Array

    def tests(self, residual: Array, jets_on: tuple[int, ...] = ()) -> JetTests:
        """Tests a residual, shape (6,), while some jets are on, by number; all others cannot lose thrust."""
        off = np.ones(len(self.clusters), dtype=bool)
        off[[number - 1 for number in jets_on]] = False
        return jet_tests(self.coefficients, residual, self.information, off, np.zeros_like(off))


@lru_cache(maxsize=1)
def setting() -> Setting:
    """Returns the constants of the single-sample tests: mass properties of table 5-2, sensors of section 5.1."""
    vehicle = orbiter()
    coefficients = signatures(unit_wrenches(vehicle), vehicle.nominal.vector(), vehicle.sample_period_s)
    accelerometer, gyro = vehicle.accelerometers[0], vehicle.gyros[0]
    variances = np.repeat([2.0 * accelerometer.variance, 2.0 * gyro.variance], 3)
    clusters = np.array([jet.cluster for jet in vehicle.jets])
    return Setting(
        coefficients, np.diag(1.0 / variances), clusters, np.repeat([accelerometer.quantum, gyro.quantum], 3)
    )


def noise_free_tests(jet_number: int, force: float, jets_on: tuple[int, ...] = ()) -> tuple[JetTests, Isolation]:
    """Computes the jet tests and the isolation of a failure without noise.

    Args:
        jet_number: its number in table 5-1.
        force: signed, lbf.
        jets_on: numbers of the jets that are on; all others cannot lose thrust.
    """
    constants = setting()
    tests = constants.tests(force * constants.coefficients[jet_number - 1], jets_on)
    return tests, isolate(tests.likelihood, constants.clusters)


def separations(_: int) -> dict[str, Array]:
    """Computes each jet's likelihood argument and margins without noise, per lbf^2, and 1-sigma of its force, lbf."""
    constants = setting()
    rows = []
    for signature in constants.coefficients:
        tests = constants.tests(signature)
        isolation = isolate(tests.likelihood, constants.clusters)
        rows.append((tests.likelihood[isolation.jet], isolation.cluster_margin, isolation.jet_margin))
    strength, cluster_margin, jet_margin = np.array(rows).T
    return {
        "argument": strength,
        "cluster_margin": cluster_margin,
        "jet_margin": jet_margin,
        "force_std": 1.0 / np.sqrt(strength),
        "cluster": constants.clusters.astype(float),
    }


def soft_failures(seed: int) -> dict[str, Array]:
    """Computes the share of samples that isolate a leak, for every jet and force, all jets off, shape (44, 10).

    The first sample of a leak at rest: each sensor component steps by its quantum at marks that lie anywhere.
    """
    constants = setting()
    random = np.random.default_rng([seed, 0])
    names = ("cluster", "jet", "wrong_cluster", "wrong_jet", "best_jet", "jet_margin")
    counts = {name: np.zeros((len(constants.clusters), len(FORCES))) for name in names}
    for jet, signature in enumerate(constants.coefficients):
        for column, force in enumerate(FORCES):
            marks = random.uniform(size=(_SAMPLES, 6))
            for sample in constants.quanta * np.floor(force * signature / constants.quanta + marks):
                likelihood = constants.tests(sample).likelihood
                isolation = isolate(likelihood, constants.clusters)
                alarm = isolation.cluster_margin > MARGIN
                right = isolation.cluster == constants.clusters[jet]
                named = alarm and isolation.jet_margin > MARGIN
                counts["cluster"][jet, column] += alarm and right
                counts["wrong_cluster"][jet, column] += alarm and not right
                counts["jet"][jet, column] += named and isolation.jet == jet
                counts["wrong_jet"][jet, column] += named and isolation.jet != jet
                own = np.where(constants.clusters == constants.clusters[jet], likelihood, -1.0)
                best = int(own.argmax())
                counts["best_jet"][jet, column] += best == jet
                others = np.delete(own, jet)
                counts["jet_margin"][jet, column] += own[jet] - others.max()
    return {name: count / _SAMPLES for name, count in counts.items()}


def vernier_gaussian(seed: int) -> dict[str, Array]:
    """Flags samples that name vernier 39, stuck on, or have it as the likeliest; Gaussian noise, all jets off."""
    constants = setting()
    named, best = [], []
    for likelihood in _draw_likelihoods([seed, 3], 400, orbiter().jets[38].thrust * constants.coefficients[38]):
        isolation = isolate(likelihood, constants.clusters)
        named.append(isolation.jet == 38 and min(isolation.cluster_margin, isolation.jet_margin) > MARGIN)
        best.append(np.where(constants.clusters == constants.clusters[38], likelihood, -1.0).argmax() == 38)
    return {"named": np.array(named, dtype=float), "best": np.array(best, dtype=float)}


def at_rest(seed: int) -> dict[str, Array]:
    """Tests healthy samples with Gaussian noise, all jets off: largest argument, and margin between clusters."""
    clusters = setting().clusters
    largest, margins = [], []
    for likelihood in _draw_likelihoods([seed, 2], 10_000, np.zeros(6)):
        largest.append(likelihood.max())
        margins.append(isolate(likelihood, clusters).cluster_margin)
    return {"largest": np.array(largest), "cluster_margin": np.array(margins)}


def _draw_likelihoods(seed: list[int], count: int, mean: Array) -> Iterator[Array]:
    """Draws samples with Gaussian noise about a mean, all jets off, and yields the likelihood argument of every jet."""
    constants = setting()
    spread = 1.0 / np.sqrt(constants.information.diagonal())
    for noise in spread * np.random.default_rng(seed).standard_normal((count, 6)):
        yield constants.tests(mean + noise).likelihood
