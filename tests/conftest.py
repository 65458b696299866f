"""What many tests share."""

from __future__ import annotations

import gc
import io
import os
import shutil
import signal
import subprocess
import sys
import tarfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from functools import cache, partial
from pathlib import Path
from typing import Any, ClassVar

import pytest
import typer
from command_probe import Massprop, Outcome
from once_probe import shared
from ruamel.yaml import YAML
from threadpoolctl import threadpool_limits

from massprop_drake import load_scenario, load_vehicle, simulate
from massprop_drake.cli import main as cli
from massprop_drake.display import figures
from massprop_drake.display.run import Run
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.studies.threads import ONE_THREAD
from reproduction import __main__ as program

REPOSITORY = Path(__file__).parent.parent

# matrices here are small: further threads of the linear algebra do nothing but wait, for each other and on the cores
# on which the other tests run
threadpool_limits(1, user_api="blas")
os.environ.update(ONE_THREAD)  # for libraries that are loaded later, and for processes that tests start

gc.set_threshold(20_000, 20, 50)  # the usual 700 new objects between two collections cost a tenth of the time

# a process of the program parses its command line once, and few files; what the tests ask of one process
# again and again is made once
typer.main.get_command = cache(typer.main.get_command)


def pytest_sessionstart() -> None:
    """Lets Ctrl-C through to what tests start: a shell has it ignored by what runs in the background."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_finish() -> None:
    """Takes what the tests themselves are out of the collection of garbage, which else goes through it every time."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session")
def orbiter() -> Vehicle:
    return load_vehicle("orbiter")


@pytest.fixture(scope="session")
def sample_maneuver() -> Scenario:
    return load_scenario("sample_maneuver")


@pytest.fixture(scope="session")
def sample_run(sample_maneuver: Scenario) -> Run:
    """The sample maneuver with seed 0; do not change its arrays."""
    return simulate(sample_maneuver)


@pytest.fixture(scope="session")
def short_run() -> Run:
    """The first 7 s of the sample maneuver, two rotations; do not change its arrays."""
    return simulate(load_scenario("sample_maneuver", ["duration_s=7"]))


# every error that a sensor can have
SENSOR_ERRORS = (
    "[{sensor: gyro, scale_factor: [1.0e-4, 0, -1.0e-4], bias: [1.0e-6, 0, -2.0e-6], bias_random_walk: 1.0e-7, "
    "noise_std: 2.0e-6}, "
    "{sensor: acc2, bandwidth_hz: 20.0, bias: [1.0e-3, 0, 0], noise_std: 0.01, delay_samples: 1}]"
)


@pytest.fixture(scope="session")
def noisy_run() -> Run:
    """The sample maneuver's first 24 s with every sensor error on; do not change its arrays."""
    return simulate(load_scenario("sample_maneuver", ["duration_s=24", "seed=7", f"sensors.errors={SENSOR_ERRORS}"]))


TOY = """
name: toy
units: si
sample_period_s: 0.1
mass_properties:
  mass: 100.0
  center_of_mass: [0.0, 0.0, 0.0]
  inertia: [[100.0, 1.0, -2.0], [1.0, 120.0, 3.0], [-2.0, 3.0, 140.0]]
gyros:
  - {name: gyro, quantum: 1.0e-6}
accelerometers:
  - {name: acc, position: [1.0, 0.0, 0.0], quantum: 1.0e-3}
jet_kinds:
  primary: {nominal_thrust: 10.0, specific_impulse_s: 70.0}
"""


def cube_data() -> dict[str, Any]:
    """A small vehicle in SI units as a file has it: a pair of jets per side of a cube."""
    data: dict[str, Any] = YAML(typ="safe", pure=True).load(TOY)
    data["jets"] = []
    for axis in range(3):
        for sign in (1.0, -1.0):
            for side in (1.0, -1.0):
                position, direction = [0.0] * 3, [0.0] * 3
                position[(axis + 1) % 3], direction[axis] = side, sign
                number = len(data["jets"]) + 1
                jet = {"number": number, "designation": f"J{number}", "cluster": number, "kind": "primary"}
                data["jets"].append({**jet, "position": position, "direction": direction, "thrust": 10.0})
    return data


@pytest.fixture
def toy_data() -> dict[str, Any]:
    """The same, a fresh copy for each test."""
    return cube_data()


@pytest.fixture(scope="session")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a short campaign, flown once for all tests; change nothing in it."""
    from campaign_probe import fly_once  # noqa: PLC0415 (beside the tests that use it)

    return fly_once(shared(tmp_path_factory))


@pytest.fixture(autouse=True)
def signals_as_before() -> Iterator[None]:
    """Whoever changes what a signal does changes it for one test: processes that are started inherit it."""
    before = {number: signal.getsignal(number) for number in (signal.SIGHUP, signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


# ------------------------------------------------------------------------------- the distributions

LINKED = ("diagrams", "scenarios")
BUILD = "import sys, setuptools.build_meta as b; getattr(b, f'build_{sys.argv[1]}')(sys.argv[2])"


def build(kind: str, source: Path, target: Path) -> Path:
    """Builds a distribution with the environment's own setuptools."""
    pytest.importorskip("setuptools", minversion="77")
    command = [sys.executable, "-W", "ignore", "-c", BUILD, kind, str(target)]
    subprocess.run(command, cwd=source, check=True, capture_output=True, text=True)
    (built,) = target.iterdir()
    return built


def checkout(folder: Path) -> Path:
    """A copy of the package, what builds it, and what is not to be built."""
    for name in ("pyproject.toml", "setup.py", "MANIFEST.in", "README.md", "LICENSE"):
        shutil.copy(REPOSITORY / name, folder)
    for name in ("massprop_drake", "reproduction", *LINKED):
        shutil.copytree(REPOSITORY / name, folder / name, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
    return folder


@pytest.fixture(scope="session")
def sdist(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The source distribution, built from a copy of the package."""
    return build("sdist", checkout(tmp_path_factory.mktemp("source")), tmp_path_factory.mktemp("sdist"))


@pytest.fixture(scope="session")
def wheel(sdist: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, built from the source distribution."""
    source = tmp_path_factory.mktemp("unpacked")
    with tarfile.open(sdist) as archive:
        archive.extractall(source, filter="data")
    (unpacked,) = source.iterdir()
    return build("wheel", unpacked, tmp_path_factory.mktemp("wheel"))


# --------------------------------------------------------------------------------- the command line


@pytest.fixture
def massprop(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> Massprop:
    """Runs the command line in this process, in an empty folder, without drawing figures."""
    monkeypatch.setattr(figures.Plots, "all", lambda _: {})
    here = tmp_path / "here"
    here.mkdir()
    monkeypatch.chdir(here)

    def call(*arguments: str | Path, stdin: bytes = b"", run: Callable[[], int] = cli.run) -> Outcome:
        monkeypatch.setattr(sys, "argv", ["massprop", *map(str, arguments)])
        monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(stdin)))
        capsys.readouterr()
        status = run()
        return Outcome(status, *capsys.readouterr())

    return call


@pytest.fixture
def reproduction(massprop: Massprop) -> Massprop:
    """Runs `python -m reproduction` likewise."""
    return partial(massprop, run=partial(cli.run, program.load, program.NAME))


# ------------------------------------------------------------------------------------ in a browser

TIMEOUT_MS = 540_000  # of a browser, however busy the machine: less than the limit of a test, to say what it waits for
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


@pytest.fixture(scope="session")
def stuck_run() -> Run:
    """A quiet vehicle whose jet 29 sticks on at 1 s; the estimates start near the truth."""
    return simulate(
        load_scenario(
            "stuck_on_29",
            [
                "duration_s=6",
                "maneuver=[{controller: rhc, axis: +x, start_s: 0.2, end_s: 0.8}]",
                "failures=[{kind: stuck_on, jet: R4R, start_s: 1}]",
                "estimation={filter: thesis, start: nominal, std_fraction: 0.001}",
            ],
        )
    )


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """Headless Chromium without network; skipped where there is none."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if CHROMIUM is None:
        pytest.skip("no Chromium is installed")
    with playwright.sync_playwright() as driver:
        flags = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-quic"]
        flags.append("--disable-gpu-compositing")  # there is no graphics card: the scene alone is drawn as by one
        chromium = driver.chromium.launch(
            executable_path=CHROMIUM, args=[*flags, "--disable-background-networking"], timeout=TIMEOUT_MS
        )
        yield chromium
        chromium.close()


class Page:
    """A page opened from disk, and what its console said."""

    VIEWPORT: ClassVar = {"width": 1000, "height": 700}

    def __init__(self, browser: Any, path: Path, before: str, ready: str):
        self.page = browser.new_page(viewport=self.VIEWPORT)
        self.page.set_default_timeout(TIMEOUT_MS)
        self.said: list[str] = []
        self.page.on("console", self._hears)
        self.page.on("pageerror", lambda error: self.said.append(f"error: {error}"))
        self.page.on("dialog", lambda dialog: (self.said.append(f"dialog: {dialog.message}"), dialog.dismiss()))
        self.page.context.set_offline(True)
        self.page.add_init_script(before)
        self.page.goto(path.as_uri())
        self.page.wait_for_selector(ready, state="attached")

    def _hears(self, message: Any) -> None:
        if "GL Driver Message" not in message.text:  # of how fast it draws, by the machine's load
            self.said.append(f"{message.type}: {message.text}")

    def until(self, expression: str) -> None:
        """Waits until an expression holds; a page's policy forbids what Playwright's `wait_for_function` does in it."""
        for _ in range(TIMEOUT_MS // 20):
            if self.page.evaluate(expression):
                return
            self.page.wait_for_timeout(20)
        raise TimeoutError(expression)

    def painted(self) -> None:
        """Waits until what has changed is on the screen: its frame has begun, and so has the next."""
        self.page.evaluate("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done())))")

    def as_opened(self, script: str) -> Page:
        """The page for the next test: its window and colors as at first, and the rest by a script of its own."""
        self.page.set_viewport_size(self.VIEWPORT)
        self.page.emulate_media(color_scheme="light")
        self.page.evaluate(script)
        return self

    def close(self) -> None:
        """Closes it."""
        self.page.context.close()


def _opened(browser: Any) -> Iterator[Any]:
    """A function that opens a file in the browser.

    `before` is a script to run before the page's own; the page is ready when it has what `ready` selects.
    """
    with ExitStack() as pages:

        def open_page(path: Path, before: str = "", ready: str = "body[data-ready=yes]") -> Page:
            return pages.enter_context(closing(Page(browser, path, before, ready)))

        yield open_page


opened = pytest.fixture(_opened, name="opened")
# of a page that all tests of a file look at; whoever changes it brings it back by `Page.as_opened`
opened_once = pytest.fixture(_opened, scope="module", name="opened_once")
