# SPDX-License-Identifier: Apache-2.0
"""What the docs show works: Python runs as it stands, commands are ones that there are."""

from __future__ import annotations

import re
import shlex
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest

from taccel_lab.cli.app import main, parse
from taccel_lab.presses import PHYSICS, Accuracy
from taccel_lab.presses.photo import LIKE
from taccel_lab.scene import Element
from tests.cli.test_press import FILES, PREDICTED
from tests.sensors.test_template import template  # noqa: F401
from tests.support.variants import variants
from tools.bench import __main__ as tools_bench

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = sorted(path for path in DOCS.rglob("*.md") if "generated" not in path.parts)
NEEDS = {
    "calibration.md": "a folder of captures and the profile fitted to it",
    "calibration_color.md": "a folder of captures",
    "calibration_markers.md": "images of a sensor",
    "captures.md": "a folder of images",
    "clusters.md": "several machines",
    "datasets.md": "a data set",
    "exporters.md": "a profile of one's own",
    "force.md": "a profile with a force model",
    "formats.md": "a profile of one's own",
    "solver.md": "several GPUs",
    "viewer.md": "a scene of one's own",
}
"""Pages whose blocks go on from files of the reader's own: compiled, not run."""
BLOCK = re.compile(r"^```(\w*)[^\n]*\n(.*?)^```", flags=re.DOTALL | re.MULTILINE)


def blocks(page: Path, *languages: str) -> list[str]:
    text = page.read_text(encoding="utf-8")
    return [body for language, body in BLOCK.findall(text) if language in languages]


def named(page: Path) -> str:
    return str(page.relative_to(ROOT))


def installed(page: Path) -> list[str]:
    """Packages of our examples that a page installs."""
    return re.findall(r"cp -r docs/examples/(\w+)", page.read_text(encoding="utf-8"))


WITH_PYTHON = [page for page in PAGES if blocks(page, "python")]


LONG = (DOCS / "tutorials" / "curved_pad.md", DOCS / "gradients.md")
"""Presses of the default accuracy, and a fit by their gradients."""


@pytest.mark.thorough(
    cases=(
        "docs/cad.md",
        "docs/environments.md",
        "docs/meshing.md",
        "docs/newton.md",
        "docs/optics.md",
        "docs/python.md",
        "docs/robots.md",
        "docs/scenes.md",
        "docs/signals.md",
        "docs/tasks.md",
        "docs/tutorials/many_environments.md",
    )
)
@pytest.mark.parametrize(
    "page", variants([page for page in WITH_PYTHON if page not in LONG], WITH_PYTHON), ids=named
)
def test_python_runs(
    page: Path, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    if page.name == "newton.md":
        pytest.importorskip("newton", reason="newton is not installed")
    if installed(page):
        request.getfixturevalue("template")
    # That a page runs does not depend on how finely its presses are meshed, nor where it draws.
    quick = replace(PHYSICS[Accuracy.FAST], element=Element.LINEAR)
    monkeypatch.setitem(PHYSICS, Accuracy.FAST, quick)
    monkeypatch.setattr("taccel_lab.processes.process_pool.usable_cores", lambda: 1)
    names: dict[str, object] = {"__name__": page.name}
    for block in blocks(page, "python"):
        code = compile(block, page.name, "exec")
        if page.name not in NEEDS:
            exec(code, names)


PROGRAMS = {"taccel-lab ": parse, "python -m tools.bench ": tools_bench.parse}


def commands(page: Path) -> list[str]:
    """Lines of a page that call us, a command a line, without what is shell."""
    found = []
    for block in blocks(page, "", "sh", "bash", "console", "text"):
        for line in block.replace("\\\n", " ").splitlines():
            line = line.strip().removeprefix("$ ")
            if line.startswith(tuple(PROGRAMS)):
                found.append(line)
    return found


CALLS = [
    pytest.param(line, id=f"{named(page)}: {line.split('#')[0].strip()}")
    for page in [ROOT / "README.md", *PAGES]
    for line in dict.fromkeys(commands(page))
]


@pytest.mark.parametrize("line", CALLS)
def test_commands_are_there(line: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    program = next(filter(line.startswith, PROGRAMS))
    words = shlex.split(line.removeprefix(program), comments=True)
    for sign in ("|", ">", "&&", "&", ";"):
        words = words[: words.index(sign)] if sign in words else words
    try:
        PROGRAMS[program](words)
    except SystemExit as left:  # --help and --version
        assert left.code in (0, None), f"{line}: exit code {left.code}"


INSTALLING = [page for page in PAGES if page.parent.name == "tutorials" and installed(page)]


@pytest.mark.parametrize("page", INSTALLING, ids=named)
def test_tutorials_show_the_sensor_that_they_install(page: Path) -> None:
    (name,) = installed(page)
    text = page.read_text(encoding="utf-8")
    shown = re.findall(r"taccel-lab (?:sensors show|design|preview|press) (\w+)", text)
    shown += re.findall(r"sensor_family\(\"(\w+)\"\)", text)
    assert shown and set(shown) == {name}


@pytest.mark.slow
@pytest.mark.usefixtures("template")
@pytest.mark.parametrize("page", INSTALLING, ids=named)
def test_commands_of_tutorials_that_install_run(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for line in commands(page):
        assert main(shlex.split(line, comments=True)[1:]) == 0, line
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        f"{installed(page)[0]}{ending}" for ending in ("", ".png", "_preview")
    ]


WRITTEN = {
    "capture guide": {"presses.gcode", "printer_presses.csv"},
    "capture record": {"captures.toml", "background.png", "press_000.png"},
    "depth": {f"press_000.{ending}" for ending in ("json", "npz", "png")},
    "design": {"profile", "preview.png"},
    "import-gel": {"profile"},
    "preview": {"overview.png"},
    "study": {"report.html"},
}
"""Files of a command that pages name; those of a press go with its profile."""


IMAGES = {"image.png", "image_raw.png"}
"""Of a press with a colour model."""


def outputs(page: Path) -> dict[str, set[str]]:
    """Files that the commands of a page write, by the folder that they are given."""
    found: dict[str, set[str]] = {}
    calibrated: set[str] = set()
    for line in commands(page):
        words = shlex.split(line, comments=True)[1:]
        if "--out" not in words:
            continue
        out = words[words.index("--out") + 1]
        if words[0] == "calibrate":
            calibrated.add(out)
        command = " ".join(words[:2]) if words[0] in ("capture", "calibrate") else words[0]
        of_press = FILES | (IMAGES if set(words) & calibrated else PREDICTED)
        of_press |= {LIKE} if "--like" in words else set()
        found[out] = of_press if command == "press" else WRITTEN.get(command, set())
    return found


@pytest.mark.parametrize("page", [ROOT / "README.md", *PAGES], ids=named)
def test_files_that_pages_name_are_written(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for out, files in outputs(page).items():
        named_here = re.findall(rf"(?<![\w/.-]){re.escape(out)}/([\w.-]*\w)", text)
        assert set(named_here) <= files, f"no command of {page.name} writes these into {out}"


@cache
def sources() -> list[str]:
    folders = [path for path in ROOT.iterdir() if path.is_dir() and path.name[0] not in "._"]
    return [str(path) for folder in folders for path in folder.rglob("*.py")]


@pytest.mark.parametrize("page", [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *PAGES], ids=named)
def test_source_files_that_pages_name_are_there(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    named_here = re.findall(r"`([\w/]+/\w+\.py)`", text)
    gone = [name for name in named_here if not any(path.endswith(f"/{name}") for path in sources())]
    folders = re.findall(r"`((?:taccel_lab|cad|calibration|sensors|tools|tests)/[\w/]+)`", text)
    gone += [name for name in folders if not (ROOT / name).exists()]
    assert not gone, f"{page.name} names files that are not there: {', '.join(gone)}"


def test_pages_name_all_results_and_no_others() -> None:
    pages = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    results = {path.stem for path in (ROOT / "benchmarks" / "results").glob("*.json")}
    stems = {name: re.sub("_(h[12]00|cpu)$", "", name) for name in results}
    quoted = set(re.findall(r"`(?:benchmarks/results/)?(\w+)(?:\.json)?`", pages))
    assert not [name for name, stem in stems.items() if not {name, stem} & quoted]
    kept = pages.split("\n## Measured once\n")[1].split("\n### ")[0]
    assert set(re.findall(r"`([a-z]+(?:_\w+)?)`", kept)) <= {*results, *stems.values()}
