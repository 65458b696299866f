"""Figures 1-1 to 5-1: drawings, each by what it says that can be checked; `massprop graph` draws our own."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from reproduction import checks
from reproduction.cases import Calculation
from reproduction.claims import AtMost, Claim, Near, Phase, Phases, reference
from reproduction.drawing import COLORS, tidy
from reproduction.entry import Entry
from reproduction.measures import orbiter, value

_WIRING = {"wiring": Calculation("wiring", checks.wiring)}


def _jets_outside_modules(_: Phase) -> float:
    """Counts jets outside the modules forward, aft left and aft right, by their position."""
    positions = orbiter().positions
    forward = positions[:, 0] > 90.0
    aft = positions[:, 0] < 0.0
    aside = np.abs(positions[:, 1]) > 9.0
    return float(np.count_nonzero(~(forward | (aft & aside))))


def _draw_jets(_: Phases) -> Figure:
    """Draws jet positions and directions of their forces, from above, from the side and from behind."""
    vehicle = orbiter()
    figure = Figure(figsize=(9.0, 7.0), dpi=100, layout="constrained")
    figure.suptitle("Jet locations and directions of the force on the vehicle (figure 5-1)", fontsize=11)
    axes = figure.subplot_mosaic("aa;bb;cd", height_ratios=(1, 0.7, 1))
    names = ("forward x, ft", "right y, ft", "down z, ft")
    directions = vehicle.thrusts / np.linalg.norm(vehicle.thrusts, axis=1)[:, None]
    fore = vehicle.positions[:, 0] > 50.0
    views = (
        ("a", 0, 1, slice(None), "from above"),
        ("b", 0, 2, slice(None), "from the side"),
        ("c", 1, 2, ~fore, "aft modules, from behind"),
        ("d", 1, 2, fore, "forward module, from behind"),
    )
    for key, across, up, which, title in views:
        panel = axes[key]
        tidy(panel)
        for kind, color in zip(("primary", "vernier"), COLORS, strict=False):
            of_kind = np.array([jet.kind == kind for jet in vehicle.jets])
            shown = np.zeros(len(of_kind), dtype=bool)
            shown[which] = True
            shown &= of_kind
            at, to = vehicle.positions[shown], directions[shown]
            panel.quiver(
                at[:, across], at[:, up], to[:, across], to[:, up], color=color, angles="xy", width=0.003, label=kind
            )
            panel.plot(at[:, across], at[:, up], "o", color=color, markersize=3)
        center = vehicle.nominal.center_of_mass
        panel.plot(center[across], center[up], "k+", markersize=9)
        panel.invert_yaxis()  # right and down point down the page
        panel.margins(0.12)
        panel.set_xlabel(names[across])
        panel.set_ylabel(names[up])
        panel.set_title(title, fontsize=9, loc="left")
    axes["a"].legend(fontsize=8)
    return figure


# fmt: off
ENTRIES = (
    Entry("fig_1_1", "Autopilot-vehicle closed loop", _WIRING, (
            Claim(1,
                "connections of the loop that our `closed_loop` diagram lacks, of five (`massprop graph closed_loop`)",
                "autopilot, jet selection, vehicle, gyros and accelerometers in a closed loop", AtMost(0.0),
                value("wiring", "missing")),
        ),
    ),
    Entry("fig_1_2", "Translation of coordinate frames", {"arms": Calculation("arms", checks.arms)}, (
            Claim(1, "largest difference of a jet's torque about the center of mass from that of its shifted wrench",
                "r = r' - r'_cm (1-4)", AtMost(1e-6), value("arms", "difference"), "ft-lbf"),
        ),
    ),
    Entry("fig_1_3", "Conceptual model of the satellite problem", _WIRING, (
            Claim(1, "true quantities among the inputs of our `estimation` diagram",
                "mass properties are unknown; sensors and commands alone tell of them", AtMost(0.0),
                value("wiring", "true_inputs")),
        ),
    ),
    Entry("fig_1_4", "Revised formulation of the satellite problem", _WIRING, (
            Claim(1, "parameters that our `estimation` diagram estimates",
                "the mass properties are the state: ten numbers", Near(10.0, 0.0), value("wiring", "parameters")),
        ),
    ),
    Entry("fig_2_1", "Rigid body angular momentum", {"momentum": Calculation("momentum", checks.momentum)}, (
            Claim(1, "relative change of L = I ω in inertial axes over 50 s without torque",
                "angular momentum of a rigid body (2-14), (2-28)", AtMost(1e-9), value("momentum", "change")),
        ),
    ),
    Entry("fig_2_2", "Second-order filter for inverse inertia and center of mass",
        {"parts": Calculation("second_order_parts", checks.second_order_parts, seeds=20)}, (
            Claim(1, "largest relative difference of our closed forms of ĥ, H and D from the 9 by 9 matrices",
                "blocks ĥ, H, D of (2-102), (2-118), (2-121)", AtMost(1e-10),
                lambda phase: float(phase["parts"]["difference"].max())),
        ),
    ),
    Entry("fig_3_1", "Filter compensation for jumps in 1/m",
        {"jump": Calculation("mass_jump_variance", checks.mass_jump_variance, seeds=20)}, (
            reference(1, "variance after a jump that one sample finds and corrects, true over claimed",
                "(jump correction (3-116) with the variance that (3-118) has without the cross term)", Near(1.0, 0.05),
                lambda phases: float(np.mean([phase["jump"]["true"] / phase["jump"]["exact"] for phase in phases])),
                pooled=True),
        ),
    ),
    Entry("fig_4_1", "Single-sample CGLR scheme", {"noise": Calculation("matched_filters", checks.matched_filters)}, (
            Claim(1, "largest relative difference of 44 matched filters from one least-squares fit per jet",
                "a matched filter per jet, then the largest (4-25) to (4-28)", AtMost(1e-9),
                value("noise", "difference")),
        ),
    ),
    Entry("fig_5_1", "RCS jet locations and thrust directions", {}, (
            Claim(1, "jets outside the three modules forward, aft left, aft right", "44 jets in three modules",
                AtMost(0.0), _jets_outside_modules),
        ),
        {"fig_5_1": _draw_jets},
    ),
)
# fmt: on
