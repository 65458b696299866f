"""Draws the pictures of README.md, from the sample maneuver and a failure after it, with seed 0.

python docs/make_images.py
"""

from __future__ import annotations

from pathlib import Path

from massprop_drake import load_scenario, simulate

IMAGES = Path(__file__).parent / "images"


def main() -> None:
    """Writes the images."""
    plot = simulate(load_scenario("sample_maneuver")).plot
    IMAGES.mkdir(exist_ok=True)
    failure = simulate(load_scenario("stuck_on_29")).plot
    failure.detection_timeline().savefig(IMAGES / "detection_timeline.png")
    for name, figure in {"inverse_inertia_diagonal": plot.inverse_inertia_diagonal(), "rates": plot.rates()}.items():
        figure.savefig(IMAGES / f"{name}.png")


if __name__ == "__main__":
    main()
