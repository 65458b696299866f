"""Draws the pictures of README.md and of the documentation, with the seeds that the texts name.

python docs/make_images.py
"""

from __future__ import annotations

import runpy
import sys
import tempfile
from pathlib import Path

from massprop_drake import graphs, load_scenario, simulate

DOCS = Path(__file__).parent
IMAGES = DOCS / "images"

# what each tutorial draws into its folder, and which of it the pages show
TUTORIALS = {
    "first_run": ["mass_reciprocal.png"],
    "build_a_diagram": ["my_loop.dot"],
    "add_a_sensor": ["with_radio_gyro.dot"],
    "add_a_failure": ["failure_magnitude.png"],
    "your_own_vehicle": ["tug_center_of_mass.png"],
    "consistency": ["nis.png"],
}
DIAGRAMS = ("closed_loop", "estimation", "autopilot")


def readme() -> None:
    """The pictures of README.md: the sample maneuver, and a failure after it."""
    plot = simulate(load_scenario("sample_maneuver")).plot
    failure = simulate(load_scenario("stuck_on_29")).plot
    failure.detection_timeline().savefig(IMAGES / "detection_timeline.png")
    for name, figure in {"inverse_inertia_diagonal": plot.inverse_inertia_diagonal(), "rates": plot.rates()}.items():
        figure.savefig(IMAGES / f"{name}.png")


def tutorials() -> None:
    """What the tutorials draw when they run."""
    for name, pictures in TUTORIALS.items():
        with tempfile.TemporaryDirectory() as folder:
            sys.argv = [name, folder]
            runpy.run_path(str(DOCS / "tutorials" / f"{name}.py"), run_name="__main__")
            for picture in pictures:
                source = Path(folder) / picture
                if source.suffix == ".dot":
                    draw(source.read_text(encoding="utf-8"), source.stem)
                else:
                    (IMAGES / picture).write_bytes(source.read_bytes())


def diagrams() -> None:
    """The diagrams that come with the package."""
    for name in DIAGRAMS:
        draw(graphs.dot_text(graphs.build(name), depth=1), name)


def draw(dot: str, name: str) -> None:
    """Draws a graph as SVG.

    Raises:
        RuntimeError: when no program that can is installed.
    """
    svg = graphs.svg_text(dot)
    if svg is None:
        raise RuntimeError("no program draws SVG: pip install graphviz-pure, or install Graphviz")
    (IMAGES / f"{name}.svg").write_text(svg, encoding="utf-8")


def main() -> None:
    """Writes the images."""
    IMAGES.mkdir(exist_ok=True)
    readme()
    tutorials()
    diagrams()


if __name__ == "__main__":
    main()
