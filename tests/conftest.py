# SPDX-License-Identifier: Apache-2.0
"""Settings shared by all tests."""

from __future__ import annotations

import fcntl
import gc
import os
import pickle
import shutil
import subprocess
from collections import Counter
from collections.abc import Generator, Iterator
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

# Before numpy or torch start their thread pools: tests run in parallel processes.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MPLBACKEND", "Agg")

import numpy as np
import pytest
import warp as wp
import warp._src.build as native
from hypothesis import HealthCheck, settings
from hypothesis.internal.conjecture import providers

from taccel_lab.cad.mesh.gel_mesh import FocusOptions, focused_gel_mesh, sound_gel_mesh
from taccel_lab.cad.parts.pad import Pad
from taccel_lab.files.file_cache import CACHE_VARIABLE
from taccel_lab.geometry import TetMesh
from taccel_lab.presses import mesh as press_mesh
from taccel_lab.sensors import profile

if TYPE_CHECKING:
    from taccel_lab.calibration.capture import CaptureSet

# Shared machines stall now and then, which says nothing about the code: no deadlines. Examples are
# derandomised, so that a change that passed keeps passing; they still depend on the version of the
# library. With TACCEL_LAB_EXPLORE=1 new ones are drawn, more of them: `make explore` does so.
EXPLORES = os.environ.get("TACCEL_LAB_EXPLORE", "0") == "1"
settings.register_profile(
    "taccel",
    deadline=None,
    max_examples=100 if EXPLORES else 25,
    print_blob=True,
    derandomize=not EXPLORES,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("taccel")
if not EXPLORES:
    # It tries the constants of every module of ours that the process has loaded, too, and so other
    # examples in each order of the tests. No setting says no to that.
    providers._get_local_constants = lambda: providers._local_constants


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, Any, Any]:
    """What is imported and collected stays: the collector of garbage need not look at it, neither
    now, which takes a quarter of the time, nor later."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


LONG = (
    "fuzz/test_kept_seeds.py",
    "viewer/test_pages.py",
    "viewer/test_design.py",
    "report/test_every_page.py",
    "report/test_page_in_browser.py",
    "calibration/record/test_page.py",
    "calibration/record/test_session.py",
    "calibration/live/test_live.py",
    "calibration/circles/test_real_contacts.py",
    "cli/test_demo.py",
    "learning/test_task_policies.py",
    "learning/force/test_fit.py",
    "datasets/test_making.py",
    "validation/test_capture_sets.py",
    "api/test_press.py",
    "test_docs.py",
)
"""Files whose few tests take longest, as ``--durations`` tells."""


def pytest_itemcollected(item: pytest.Item) -> None:
    """``thorough(cases=...)`` names the dear cases of a test: the others stay in ``make test``."""
    for mark in item.iter_markers("thorough"):
        cases = mark.kwargs.get("cases")
        if cases is not None and item.name.partition("[")[2][:-1] not in cases:
            item.own_markers.remove(mark)


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Long files and notebooks begin first, then those of many tests: where a process takes one
    file after the other, none is left with a long one when the others are done."""
    first = {Path(__file__).parent / name for name in LONG}
    first |= {item.path for item in items if item.path.suffix == ".ipynb"}
    counts = Counter(item.path for item in items)
    items.sort(key=lambda item: (item.path not in first, -counts[item.path], str(item.path)))


KEPT_MESHES = 32

# Arrays whose device a test does not name are where its models are.
wp.set_device(os.environ.get("TACCEL_LAB_DEVICE", "cpu"))


@pytest.fixture(scope="session", autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Tests neither read nor fill the user's cache; processes that run beside each other share."""
    beside = "PYTEST_XDIST_WORKER" in os.environ
    folder = tmp_path_factory.getbasetemp()
    with pytest.MonkeyPatch.context() as patch:
        # But kernels take minutes to compile, and depend on their source alone.
        patch.setenv("WARP_CACHE_PATH", str(Path(str(wp.config.kernel_cache_dir)).parent))
        patch.setenv(CACHE_VARIABLE, str((folder.parent if beside else folder) / "cache"))
        yield


@pytest.fixture(scope="session", autouse=True)
def _kernels_are_compiled_once(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Processes that run beside each other begin with the same kernels: one compiles a module, the
    others wait and take its object."""
    if "PYTEST_XDIST_WORKER" not in os.environ:
        yield
        return
    built = tmp_path_factory.getbasetemp().parent / "kernels"
    built.mkdir(exist_ok=True)
    compiled = native.build_cpu

    def build_cpu(object_path: str, *inputs: Any, **options: Any) -> None:
        # The name has the digest of the module's source, and that of the compiler's options.
        kept = built / Path(object_path).name
        with kept.with_suffix(".lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if kept.exists():
                shutil.copyfile(kept, object_path)
                return
            compiled(object_path, *inputs, **options)
            shutil.copyfile(object_path, kept)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(native, "build_cpu", build_cpu)
        yield


@pytest.fixture(scope="session", autouse=True)
def _catalogue_is_meshed_once() -> Iterator[None]:
    """Hundreds of tests start from a sensor of the catalogue, whose mesh takes a third of a second;
    it depends on the pad alone."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(profile, "sound_gel_mesh", lru_cache(sound_gel_mesh))
        yield


@pytest.fixture(scope="session", autouse=True)
def _equal_presses_are_meshed_once() -> Iterator[None]:
    """Tests beside one another press the same pad at the same place; its mesh takes a tenth of a
    second to a whole one, and depends on pad and focus alone."""
    known: dict[bytes, TetMesh] = {}

    def meshed(pad: Pad, focus: FocusOptions) -> TetMesh:
        key = pickle.dumps((pad, focus))
        if key not in known:
            if len(known) == KEPT_MESHES:
                del known[next(iter(known))]
            known[key] = focused_gel_mesh(pad, focus)
        return known[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(press_mesh, "focused_gel_mesh", meshed)
        yield


RASTERISED = pytest.StashKey[bool]()


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Before the fixtures of the test, which may draw."""
    item.config.stash[RASTERISED] = item.get_closest_marker("rasterised") is not None


@pytest.fixture(scope="session", autouse=True)
def _figures_are_not_rasterised(pytestconfig: pytest.Config) -> Iterator[None]:
    """Figures are made, but noise stands for their pixels, which few tests look at: those of a
    press take twice as long as the press. ``rasterised`` marks those that look."""
    if find_spec("matplotlib") is None:
        # A bare machine, whose tests draw nothing.
        yield
        return
    import cv2
    from matplotlib.figure import Figure

    save = Figure.savefig
    noise = np.random.default_rng(0).integers(0, 256, (64, 64, 3), dtype=np.uint8)
    stand_in = cv2.imencode(".png", noise)[1].tobytes()

    def savefig(figure: Figure, file: Any, **options: Any) -> None:
        if pytestconfig.stash[RASTERISED] or options.get("format", "png") != "png":
            save(figure, file, **options)
        elif isinstance(file, (str, Path)):
            Path(file).write_bytes(stand_in)
        else:
            file.write(stand_in)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", savefig)
        yield


@pytest.fixture
def small_drive(tmp_path: Path) -> Iterator[Path]:
    """A file system with room for 64 KiB."""
    drive = tmp_path / "drive"
    drive.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(drive)]
    if not shutil.which("mount") or subprocess.run(mount, capture_output=True).returncode:
        pytest.skip("this user may not mount a file system")
    yield drive
    subprocess.run(["umount", str(drive)], check=True)


@pytest.fixture(scope="session")
def taxim_captures() -> CaptureSet:
    """The real presses, where they are installed."""
    from taccel_lab.calibration.capture import load_captures
    from tests.support.real_data import taxim_presses

    return load_captures(taxim_presses())
