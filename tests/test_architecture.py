# SPDX-License-Identifier: Apache-2.0
"""The shape of the code base: light imports, arrows between packages, small files, headers."""

from __future__ import annotations

import ast
import inspect
import re
import subprocess
import sys
import tomllib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("taccel_lab", "sensors", "calibration", "cad", "tools/bench")
SOURCES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
TESTS = sorted((ROOT / "tests").rglob("*.py"))
HEAVY = (
    "OCP", "build123d", "cv2", "kornia", "matplotlib", "nlopt", "optuna", "pytetwild", "pyvista",
    "scipy", "torch", "trimesh", "vtk", "warp", "yourdfpy",
)  # fmt: skip
MAX_LINES = 450
LICENCE_LINE = "# SPDX-License-Identifier: Apache-2.0\n"


def texts(paths: list[Path] = SOURCES) -> Iterator[tuple[str, str]]:
    """Names and texts of files."""
    for path in paths:
        yield str(path.relative_to(ROOT)), path.read_text(encoding="utf-8")


def python(code: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done


LIBRARY_WRITERS = re.compile(
    r"(?<!def )(?<![\w`])(?:[\w.]*\.)?"
    r"(savefig|savez|savez_compressed|save_file|imwrite|VideoWriter"
    r"|np\.save|torch\.save|onnx\.save|(?:pq|parquet)\.write_table|h5py\.File)"
    r"\(\s*(?!(?:file|buffer|sink|stream|table, file|table, sink|listed, file|tasks, file)\b)"
)
"""Calls by which a library writes into a path."""


@pytest.mark.thorough
def test_libraries_write_into_memory() -> None:
    """``write_by`` puts what they wrote into the file: of a full disk they tell as they like."""
    for call in ("    np.savez(path, a=a)", "figure.savefig(\n    path)"):
        assert LIBRARY_WRITERS.search(call)
    assert not LIBRARY_WRITERS.search("write_by(path, partial(np.savez, a=a)); np.save(file, a)")
    paths = re.compile(r"\.(?:save|write|saveas|export)\(str\(")
    for name, text in texts():
        hits = [hit[0] for hit in LIBRARY_WRITERS.finditer(text)]
        assert not hits or name == "taccel_lab/files/hdf5_images.py", (name, hits)
        assert not paths.search(text), name


def test_there_is_something_to_check() -> None:
    assert len(SOURCES) > 20
    assert all(any(path.is_relative_to(ROOT / name) for path in SOURCES) for name in PACKAGES)


def test_files_are_short_and_headed() -> None:
    """All of them in one test, which names those that are not."""
    wrong = {}
    for name, text in texts(SOURCES + TESTS):
        # Nothing is parsed: 1,600 syntax trees take 30 s.
        code = text.removeprefix(LICENCE_LINE).lstrip()
        said = {
            "no licence in its first line": not text.startswith(LICENCE_LINE),
            f"{MAX_LINES} lines or more": text.count("\n") >= MAX_LINES,
            "no module docstring": bool(code) and not re.match('r?"""', code),
        }
        wrong[name] = [what for what, found in said.items() if found]
    assert not {name: what for name, what in wrong.items() if what}


def test_imports_are_light() -> None:
    names = "taccel_lab, taccel_lab.profile, taccel_lab.geometry, taccel_lab.cli.app"
    code = f"import {names}, sys\nprint(*sorted(set({HEAVY!r}) & set(sys.modules)))"
    assert python(code).stdout.split() == []


@pytest.mark.thorough
def test_blocks_of_images_load_no_solver() -> None:
    code = "import sys, taccel_lab.calibration.calibrate\nprint(*sys.modules)"
    assert "taccel_lab.solvers.solver_ipc" not in python(code).stdout.split()


_BARE = """
import sys
import tomllib
sys.modules.update(dict.fromkeys({absent!r}))  # None makes the import of a module fail.
import warp as wp
wp.config.log_level = wp.LOG_ERROR
import {modules}
"""


BARE_ROOMS = {
    # Compute nodes have neither CAD nor command line: presses and renders must run there.
    "taccel_lab.presses, taccel_lab.signals, taccel_lab.outputs, taccel_lab.optics.render, "
    "taccel_lab.studies.evaluate.evaluate, taccel_lab.benchmarks.speed": [
        *(name for name in HEAVY if name != "warp"),
        *("pydantic", "rich", "tyro", "jinja2", "tomli_w", "safetensors", "PIL"),
    ],
    # Only environments need the extra ``learning``; the main job's installation has none.
    "taccel_lab.cli.app, taccel_lab.cli.calibrate_all, taccel_lab.cli.calibrate, "
    "taccel_lab.api.demonstration, taccel_lab.api.press, taccel_lab.calibration.calibrate, "
    "taccel_lab.learning.force.fit": [*("gymnasium", "onnx", "h5py", "pyarrow", "newton")],
}
"""Modules, and what they load without."""


@pytest.mark.thorough
@pytest.mark.parametrize(("modules", "absent"), BARE_ROOMS.items(), ids=["core", "calibration"])
def test_what_a_bare_machine_runs_needs_no_more(modules: str, absent: list[str]) -> None:
    python(_BARE.format(absent=absent, modules=modules))


def test_public_names_exist() -> None:
    import taccel_lab

    for name in taccel_lab.__all__:
        assert getattr(taccel_lab, name) is not None
    assert set(dir(taccel_lab)) == set(taccel_lab.__all__)
    from taccel_lab import Scene, SignalTactile, SolverIPC, State  # loaded on first use
    from taccel_lab.scene import Scene as OfItsPackage

    assert Scene is OfItsPackage
    names = [c.__name__ for c in (SignalTactile, SolverIPC, State)]
    assert names == ["SignalTactile", "SolverIPC", "State"]
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = taccel_lab.nonsense


PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")


def test_a_profiler_can_tell_every_kernel_from_the_others() -> None:
    """Also those that are defined inside of functions."""
    kernel = re.compile(r"@wp\.kernel.*\n *def (\w+)")
    names = Counter(name for _, text in texts() for name in kernel.findall(text))
    assert len(names) > 200
    assert not [name for name, count in names.items() if count > 1]


def table_of(heading: str) -> list[list[str]]:
    """Cells of the rows of the table under a heading of the page."""
    section = PAGE.split(f"## {heading}\n")[1].split("\n## ")[0]
    rows = [line.strip("|").split("|") for line in section.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in row] for row in rows[2:]]


def test_the_page_has_every_package_in_the_order_of_the_contract() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    (layers,) = (
        contract
        for contract in settings["tool"]["importlinter"]["contracts"]
        if contract["type"] == "layers"
    )
    assert layers["exhaustive"]
    contract = [package.strip() for layer in layers["layers"] for package in layer.split("|")]
    named = [row[0].strip("`").strip("/") for row in table_of("Packages, from the top layer down")]
    page = [name.removeprefix("taccel_lab/").removesuffix(".py") for name in named]
    assert page == contract
    assert not layers.get("ignore_imports")


def test_what_the_page_names_is_there() -> None:
    named = set(re.findall(r"`([\w/]+(?:/|\.py))`", PAGE))
    assert named and not {path for path in named if not (ROOT / path).exists()}


def test_every_block_of_a_calibration_has_the_same_shape() -> None:
    from taccel_lab.calibration.blocks import HOMES, all_blocks

    blocks = all_blocks()
    assert [block.name for block in blocks] == list(HOMES)
    for block in blocks:
        assert block.home == HOMES[block.name]
        assert callable(block.describe)
        fit = ast.parse(Path(inspect.getfile(block.verb)).read_text(encoding="utf-8"))
        verb = next(
            node
            for node in fit.body
            if isinstance(node, ast.FunctionDef) and node.name == f"calibrate_{block.name}"
        )
        options = [] if block.options is None else ["options"]
        arguments = [argument.arg for argument in verb.args.args]
        assert arguments == ["folder", "base", *options, "progress"]


TEXT_FORMATS = {"tomllib", "yaml", "csv", "json"}
OWN_FILES = dict.fromkeys(
    (
        "calibration/circles/usable.py",
        "calibration/live/recorded.py",
        "taccel_lab/benchmarks/speed.py",
    ),
    "json",
)
"""A digest guards what a cache kept; rows of an interrupted reading begin with one; times come from
a process of ours."""
WRITERS = {
    "calibration/markers/tracks.py": "csv",
    "taccel_lab/studies/evaluate/study_folder.py": "csv",
    "taccel_lab/exporters/gs_sdk.py": "yaml",
    "taccel_lab/exporters/tacto.py": "yaml",
}
_PARSERS = {"load", "loads", "safe_load", "reader", "DictReader"}


@pytest.mark.thorough
def test_text_formats_are_read_in_one_place() -> None:
    """Elsewhere they are written, or read from files of our own: their readers know the limits."""
    known, mentioned = {**OWN_FILES, **WRITERS}, re.compile(rf"\b(?:{'|'.join(TEXT_FORMATS)})\b")
    for name, text in texts():
        if name.startswith(("taccel_lab/files/", "tools/")):
            continue
        for node in ast.walk(ast.parse(text)) if mentioned.search(text) else ():
            imports = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            imports += [node.module] if isinstance(node, ast.ImportFrom) else []
            used = {*imports} & (TEXT_FORMATS - {"json"})
            assert used <= {known.get(name)}, f"{name} imports {used}: use taccel_lab.files"
            match node:
                case ast.Attribute(value=ast.Name(id=module), attr=call):
                    if module in TEXT_FORMATS and call in _PARSERS:
                        assert OWN_FILES.get(name) == module, f"{name} parses {module}"


SERVING, WRITING = "taccel_lab/report/live_page.py", "taccel_lab/report/page_text.py"
PAGE_WORDS = {
    r"ViserServer\(": SERVING,
    r"\bhttp\.server\b|\bsocketserver\b|\.listen\(|\b(create|start)_server\(|aiohttp": None,
    r"\badd_markdown\(|\badd_html\(|\bimport html\b": WRITING,
}


@pytest.mark.thorough
def test_pages_are_served_and_written_in_one_place() -> None:
    """Behind the guard of pages; what they show is escaped there."""
    for name, text in texts():
        for word, place in PAGE_WORDS.items():
            assert not re.search(word, text) or name == place, f"{name}: {word} is for {place}"
