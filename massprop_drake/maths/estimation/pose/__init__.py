"""The estimator in a fixed frame: poses, velocities, rates and accelerations in any mix, thrust factors of every jet.

`layout` says what stands where; `openings` what valves let through; `prediction` and `measurement` are the model;
`cycle` is one sample for a bank of filters side by side; `hypotheses` compares them; `outcome` gives mass properties.
"""
