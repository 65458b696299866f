"""The joint estimator: mass properties, rate and integrated velocity in one state, with one covariance.

`layout` says what stands where; `joint_cycle.step` takes a state and a sample to the next state. The other modules have
one part of a cycle each: `lagged_impulses`, `prediction`, `measurement`, `thrust_scale`, `guard`, and `covariance`,
which keeps the covariance as a square root. `bound` is the Cramér-Rao bound by the same recursion.
"""
