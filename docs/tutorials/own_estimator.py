"""An estimator of your own beside ours: python own_estimator.py [FOLDER]."""

import sys
import tempfile

import numpy as np
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from massprop_drake import load_scenario, simulate
from massprop_drake.diagrams import closed_loop
from massprop_drake.maths.mass_properties import pack


class LeastSquares(LeafSystem):
    """Least-squares estimate of inverse inertia from gained rates and commanded impulses."""

    def __init__(self, period_s, squares):
        super().__init__()
        self.set_name("least_squares")
        self._gyro = self.DeclareVectorInputPort("gyro", 3)
        self._impulses = self.DeclareVectorInputPort("impulses", 8)
        self.DeclareDiscreteState(np.hstack([np.zeros(3), squares.ravel(), np.zeros(18)]))
        self.DeclarePeriodicDiscreteUpdateEvent(period_s, 0.0, self._update)
        self.DeclareVectorOutputPort("estimate", 10, self._calc_estimate)

    def _update(self, context, state):
        before, squares, products = np.split(context.get_discrete_state_vector().value(), [3, 39])
        rate, impulse = self._gyro.Eval(context), self._impulses.Eval(context)[:6]
        squares = squares + np.outer(impulse, impulse).ravel()
        products = products + np.outer(impulse, rate - before).ravel()
        state.set_value(np.hstack([rate, squares, products]))

    def _calc_estimate(self, context, output):
        _, squares, products = np.split(context.get_discrete_state_vector().value(), [3, 39])
        inverse_inertia = np.linalg.solve(squares.reshape(6, 6), products.reshape(6, 3))[:3]
        output.SetFromVector(pack(inverse_inertia, np.full(3, np.nan), np.nan))


scenario = load_scenario("sample_maneuver")
builder = DiagramBuilder()
loop = builder.AddNamedSystem("loop", closed_loop.build(scenario))
period_s, wrenches = scenario.vehicle_data.sample_period_s, scenario.vehicle_data.wrenches
least = 1e-3 * period_s * wrenches  # impulses of a thousandth of a sample, one row a jet
mine = builder.AddSystem(LeastSquares(period_s, np.diag((least**2).sum(axis=0))))
for name in ("gyro", "impulses"):
    builder.Connect(loop.GetOutputPort(name), mine.GetInputPort(name))
run = simulate(scenario, diagram=builder, log=[mine.GetOutputPort("estimate")])
for name in ("estimate", "least_squares.estimate"):
    print(name, np.round(100 * (run[name][-1, :3] / run["truth"][-1, :3] - 1), 3), "% off")
folder = sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp()
run.save(f"{folder}/run")
run.plot.inverse_inertia_diagonal().savefig(f"{folder}/own_estimator.png")
