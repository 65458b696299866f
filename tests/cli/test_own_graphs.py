"""`massprop graph` of a diagram of the user's own, built by a function that is named; one message for each slip."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from textwrap import dedent

import pytest
from command_probe import Massprop, contents, require_refused

from massprop_drake.display import graphs
from massprop_drake.results.folder import write_files

PROGRAM = dedent(
    '''
    """A loop of a user's own."""

    import numpy as np
    from pydrake.systems.framework import DiagramBuilder
    from pydrake.systems.primitives import Integrator, Gain

    from gains import GAIN

    SIZE = 2


    def diagram(size=SIZE):
        print("built")
        made = DiagramBuilder()
        gain = made.AddNamedSystem('a "<gain>" & more', Gain(GAIN, size))
        state = made.AddNamedSystem("state", Integrator(size))
        made.Connect(gain.get_output_port(), state.get_input_port())
        made.Connect(state.get_output_port(), gain.get_input_port())
        return made.Build()


    def system():
        return Integrator(SIZE)


    def told(size, *, name, more=1):
        return diagram(size)


    def wrong():
        return np.linalg.inv(np.zeros((2, 3)))


    def demands():
        made = DiagramBuilder()
        for _ in range(2):
            made.AddNamedSystem("twice", Integrator(SIZE))
        return made


    def nothing():
        return None


    def gives_up():
        raise GeneratorExit
    '''
)
WRONG_LINE = PROGRAM[: PROGRAM.index("return np")].count("\n") + 1


@pytest.fixture(autouse=True)
def here(massprop: Massprop) -> None:
    """A folder with the user's program and a module that it imports, for commands by `massprop` run in it."""
    del massprop
    Path("gains.py").write_text("GAIN = -1.0\n", encoding="utf-8")
    Path("own_loop.py").write_text(PROGRAM, encoding="utf-8")
    for name in ("own_loop", "gains", "package", "package.loop"):  # of another test's folder
        sys.modules.pop(name, None)


@pytest.mark.parametrize("function", ["diagram", "system"])
def test_a_diagram_of_ones_own_is_drawn_like_ours(massprop: Massprop, function: str) -> None:
    done = massprop("graph", f"own_loop.py:{function}", "--out", "graphs", "--json")
    assert done.status == 0
    name = f"own_loop_{function}"
    files = [f"{name}{part}.{kind}" for part in ("", "_overview") for kind in ("dot", "svg")]
    assert sorted(json.loads(done.out)) == sorted(f"graphs/{file}" for file in files)  # what it prints is not there
    assert done.err == ("" if function == "system" else "built\n")
    assert sorted(path.name for path in Path("graphs").iterdir()) == sorted([*files, "manifest.json"])
    overview = Path("graphs", f"{name}_overview.dot").read_text(encoding="utf-8")
    assert "<B>Integrator</B>" in overview or '<FONT POINT-SIZE="12">Integrator' in overview
    if function != "system":
        assert r'"state" -> "a \"<gain>\" & more" [label="u0"];' in overview
        assert "&lt;gain&gt;" in Path("graphs", f"{name}.svg").read_text(encoding="utf-8")


def test_a_module_is_found_in_the_current_folder_and_in_packages(massprop: Massprop) -> None:
    Path("package").mkdir()
    Path("package", "__init__.py").write_text("", encoding="utf-8")
    Path("package", "loop.py").write_text("from own_loop import diagram as build\n", encoding="utf-8")
    done = massprop("graph", "own_loop:diagram", "package.loop:build", "autopilot", "--out", "graphs")
    assert (done.status, done.err) == (0, "built\nbuilt\n")
    names = {path.name.partition("_overview")[0].partition(".")[0] for path in Path("graphs").iterdir()}
    assert names == {"autopilot", "loop_build", "own_loop_diagram", "manifest"}


@pytest.mark.parametrize(
    ("target", "message"),
    [
        ("own_lop:diagram", "there is no module 'own_lop' here; of a file give its path, such as own_lop.py"),
        ("there/own_loop.py:diagram", "there is no file there/own_loop.py"),
        ("own_loop.py:diagra", "'diagra' is not there; did you mean 'diagram'?"),
        ("own_loop.py:SIZE", "'SIZE' is no function"),
        ("own_loop.py:told", "needs arguments, size, name; give a function that needs none"),
        (
            "own_loop.py:wrong",
            f"LinAlgError: Last 2 dimensions of the array must be square (own_loop.py, line {WRONG_LINE})",
        ),
        ("own_loop.py:demands", 'SystemExit: Non-unique name "twice" for subsystem'),
        ("own_loop.py:gives_up", "GeneratorExit: no message (own_loop.py, line"),
        ("own_loop.py:nothing", "returned NoneType; it must return a Diagram, a DiagramBuilder or a System"),
        ("broken.py:build", "SyntaxError: invalid syntax (broken.py, line 2)"),
        ("lacking.py:build", "ModuleNotFoundError: No module named 'not_installed' (lacking.py, line 1)"),
        (":build", "give MODULE:FUNCTION or FILE.py:FUNCTION, such as my_loop.py:build"),
    ],
)
def test_a_slip_gets_one_message(massprop: Massprop, target: str, message: str) -> None:
    Path("broken.py").write_text("import os\nreturn = 3\n", encoding="utf-8")
    Path("lacking.py").write_text("import not_installed\n", encoding="utf-8")
    require_refused(massprop("graph", target, "--out", "graphs"), f"massprop: {target}: {message}")
    assert not Path("graphs").exists() or list(Path("graphs").iterdir()) == []


def test_graphs_are_put_into_no_campaign_and_no_run(massprop: Massprop, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(graphs, "svg_text", lambda _: None)
    assert massprop("campaign", "plan", "healthy_maneuver", "--set", "cases=2", "--out", "campaign", "-q").status == 0
    write_files(Path("run"), {"summary.json": b"{}", "results/one": b"of a run"})
    before = contents()
    for folder in ("campaign", "run", "campaign/results", "run/results"):
        for force in ((), ("--force",)):
            require_refused(massprop("graph", "autopilot", "--out", folder, *force), "give another folder")
    assert contents() == before
