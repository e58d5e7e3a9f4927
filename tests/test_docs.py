# SPDX-License-Identifier: Apache-2.0
"""What the docs show works: Python runs as it stands, commands are ones that there are."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from taccel_lab.cli.app import parse

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = sorted(path for path in DOCS.rglob("*.md") if "generated" not in path.parts)
NEEDS = {
    "calibration.md": "a folder of captures and the profile fitted to it",
    "calibration_color.md": "a folder of captures",
    "calibration_markers.md": "images of a sensor",
    "captures.md": "a folder of images",
    "datasets.md": "a data set",
    "exporters.md": "a profile of one's own",
    "force.md": "a profile with a force model",
    "formats.md": "a profile of one's own",
    "solver.md": "several GPUs",
    "studies.md": "a study's results",
    "viewer.md": "a scene of one's own",
}
"""Pages whose blocks go on from files of the reader's own: compiled, not run."""
BLOCK = re.compile(r"^```(\w*)[^\n]*\n(.*?)^```", flags=re.DOTALL | re.MULTILINE)


def blocks(page: Path, *languages: str) -> list[str]:
    text = page.read_text(encoding="utf-8")
    return [body for language, body in BLOCK.findall(text) if language in languages]


def named(page: Path) -> str:
    return str(page.relative_to(ROOT))


WITH_PYTHON = [page for page in PAGES if blocks(page, "python")]


@pytest.mark.parametrize("page", WITH_PYTHON, ids=named)
def test_python_runs(page: Path) -> None:
    if page.name == "newton.md":
        pytest.importorskip("newton", reason="newton is not installed")
    names: dict[str, object] = {"__name__": page.name}
    for block in blocks(page, "python"):
        code = compile(block, page.name, "exec")
        if page.name not in NEEDS:
            exec(code, names)


def commands(page: Path) -> list[str]:
    """Lines of a page that call us, a command a line, without what is shell."""
    found = []
    for block in blocks(page, "", "sh", "bash", "console", "text"):
        for line in block.replace("\\\n", " ").splitlines():
            line = line.strip().removeprefix("$ ")
            if line.startswith("taccel-lab "):
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
    words = shlex.split(line, comments=True)[1:]
    for sign in ("|", ">", "&&", "&", ";"):
        words = words[: words.index(sign)] if sign in words else words
    try:
        parse(words)
    except SystemExit as left:  # --help and --version
        assert left.code in (0, None), f"{line}: exit code {left.code}"
