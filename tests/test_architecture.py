# SPDX-License-Identifier: Apache-2.0
"""The shape of the code base: light imports, arrows between packages, small files, headers."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("taccel_lab", "cli", "sensors", "calibration", "cad", "studies", "benchmarks")
SOURCES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
TESTS = sorted((ROOT / "tests").rglob("*.py"))
HEAVY = (
    "OCP",
    "build123d",
    "cv2",
    "kornia",
    "matplotlib",
    "nlopt",
    "pymeshlab",
    "pytetwild",
    "pyvista",
    "scipy",
    "torch",
    "vtk",
    "warp",
)
MAX_LINES = 450


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


def test_there_is_something_to_check() -> None:
    assert len(SOURCES) > 20
    assert {path.relative_to(ROOT).parts[0] for path in SOURCES} == set(PACKAGES)


@pytest.mark.parametrize("path", SOURCES + TESTS, ids=name_of)
def test_files_are_short_and_headed(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert text.startswith("# SPDX-License-Identifier: Apache-2.0\n")
    assert text.count("\n") < MAX_LINES
    tree = ast.parse(text)
    assert not tree.body or ast.get_docstring(tree), f"{path} has no module docstring"


@pytest.mark.parametrize(
    "statement",
    ["import taccel_lab", "import taccel_lab.profile, taccel_lab.geometry, taccel_lab.cli.app"],
)
def test_imports_are_light(statement: str) -> None:
    code = f"{statement}\nimport sys\nprint(*sorted(set({HEAVY!r}) & set(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == []


_BARE = """
import sys
sys.modules.update(dict.fromkeys({absent!r}))  # None makes the import of a module fail.
import warp as wp
wp.config.log_level = wp.LOG_ERROR
import {modules}
"""


def test_the_core_and_the_presses_of_studies_need_warp_numpy_and_scipy_alone() -> None:
    """Compute nodes have neither CAD nor command line: presses and renders must run there."""
    absent = [name for name in HEAVY if name not in ("warp", "scipy")]
    absent += ["pydantic", "rich", "tyro", "jinja2", "tomli_w", "safetensors", "PIL"]
    modules = "taccel_lab.envs, taccel_lab.signals, taccel_lab.outputs, taccel_lab.optics.render"
    code = _BARE.format(
        absent=absent,
        modules=f"{modules}, taccel_lab.studies.evaluate, taccel_lab.benchmarks.design_study",
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


def test_public_names_exist() -> None:
    import taccel_lab

    for name in taccel_lab.__all__:
        assert getattr(taccel_lab, name) is not None
    assert set(dir(taccel_lab)) == set(taccel_lab.__all__)
    from taccel_lab import Scene, SignalTactile, SolverIPC, State  # loaded on first use
    from taccel_lab.scene import Scene as OfItsRoom

    assert Scene is OfItsRoom
    assert [c.__name__ for c in (SignalTactile, SolverIPC, State)] == [
        "SignalTactile",
        "SolverIPC",
        "State",
    ]
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = taccel_lab.nonsense
