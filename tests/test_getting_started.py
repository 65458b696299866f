"""Commands of docs/getting_started.md work in their order, and print what is shown."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import REPOSITORY, Massprop
from page_probe import blocks, commands, unshown

PAGE = (REPOSITORY / "docs" / "getting_started.md").read_text(encoding="utf-8")

pytestmark = pytest.mark.documentation


def test_typed_from_top_to_bottom(massprop: Massprop) -> None:
    for block in blocks(PAGE, "yaml"):
        name = re.match(r"name: (\w+)\n", block)
        assert name is not None
        Path(f"{name[1]}.yaml").write_text(block, encoding="utf-8")
        assert f"`{name[1]}.yaml`" in PAGE
    scripts = {"make_log.py": "np.savetxt", "my_diagram.py": "DiagramBuilder"}
    for script, has in scripts.items():
        (code,) = (block for block in blocks(PAGE, "python") if has in block)
        Path(script).write_text(code, encoding="utf-8")
    said = ""
    for words in commands(PAGE):
        if words[0] == "massprop":
            done = massprop(*words[1:])
            assert done.status == 0, f"{words}: {done.err}"
            said += done.out
        elif words[0] == "python":
            assert words[1] in scripts
            ran = subprocess.run([sys.executable, words[1]], capture_output=True, text=True, check=True)
            said += ran.stdout
        else:
            assert words == ["pip", "install", "."]
    assert [unshown(block, said) for block in blocks(PAGE, "text")] == [[]] * len(blocks(PAGE, "text"))
    for line in re.findall(r"^prints `([^`]+)`", PAGE, flags=re.MULTILINE):
        assert unshown(line, said) == []
    (plain,) = (block for block in blocks(PAGE, "python") if "run.plot" in block)
    exec(compile(plain, "getting_started.md", "exec"), {"__name__": "page"})
    assert Path("rates.png").stat().st_size > 0
    listed = {name.rstrip("/") for name in re.findall(r"^\| `([\w./]+)`", PAGE, flags=re.MULTILINE)}
    assert listed == {path.name for path in Path("runs/leak").iterdir()}
