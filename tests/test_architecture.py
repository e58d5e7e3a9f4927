# SPDX-License-Identifier: Apache-2.0
"""The shape of the code base: light imports, arrows between packages, small files, headers."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("taccel_lab", "sensors", "calibration", "cad", "studies", "benchmarks")
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

# What each package may import of ours. Finer than the contracts in pyproject.toml, which also
# follow chains of imports.
ALLOWED = {
    "cad": ("cad", "taccel_lab.geometry", "taccel_lab.errors", "taccel_lab.output"),
    "sensors": (
        "sensors",
        "cad",
        "taccel_lab.profile",
        "taccel_lab.geometry",
        "taccel_lab.errors",
        "taccel_lab.output",
        "taccel_lab.optics.description",
    ),
    "calibration": ("calibration", "sensors", "taccel_lab"),
    "studies": ("studies", "sensors", "cad", "taccel_lab"),
    "benchmarks": ("benchmarks", "calibration", "studies", "sensors", "cad", "taccel_lab"),
    "taccel_lab": ("taccel_lab",),
    "taccel_lab.cli": ("taccel_lab", "calibration", "studies", "sensors", "cad"),
    "taccel_lab.cli.bench": ("taccel_lab", "benchmarks"),
}


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports_of(path: Path) -> Iterator[tuple[int, str]]:
    """(line, module) of every import in a file, those inside functions too."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}:{node.lineno}: relative import"
            module = node.module or ""
            # `from taccel_lab import errors` means taccel_lab.errors when that is a module.
            for alias in node.names:
                full = f"{module}.{alias.name}"
                target = ROOT / full.replace(".", "/")
                is_module = target.is_dir() or target.with_suffix(".py").is_file()
                yield node.lineno, full if is_module else module


def within(module: str, package: str) -> bool:
    return module == package or module.startswith(package + ".")


def test_there_is_something_to_check() -> None:
    assert len(SOURCES) > 20
    assert {path.relative_to(ROOT).parts[0] for path in SOURCES} == set(PACKAGES)


@pytest.mark.parametrize("path", SOURCES, ids=module_name)
def test_arrows(path: Path) -> None:
    module = module_name(path)
    owner = next(name for name in reversed(ALLOWED) if within(module, name))
    wrong = [
        f"{path}:{line} imports {target}"
        for line, target in imports_of(path)
        if any(within(target, package) for package in PACKAGES)
        and not any(within(target, allowed) for allowed in ALLOWED[owner])
    ]
    if owner == "taccel_lab":
        wrong += [
            f"{path}:{line} imports {target}"
            for line, target in imports_of(path)
            if within(target, "taccel_lab.cli")
        ]
    assert not wrong


@pytest.mark.parametrize("path", SOURCES + TESTS, ids=lambda p: str(p.relative_to(ROOT)))
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
        absent=absent, modules=f"{modules}, studies.evaluate, benchmarks.design_study"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


def test_public_names_exist() -> None:
    import taccel_lab

    for name in taccel_lab.__all__:
        assert getattr(taccel_lab, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = taccel_lab.nonsense
