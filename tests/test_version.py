# SPDX-License-Identifier: Apache-2.0
"""One version: changelog, citation, command line and archives state that of the source."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tarfile
from pathlib import Path

import pytest
import yaml
from packaging.version import Version

from taccel_lab.cli.app import main
from taccel_lab.profile import Provenance
from taccel_lab.report.citation import CITATION
from taccel_lab.report.page import Page, page_html
from taccel_lab.version import __version__

ROOT = Path(__file__).parents[1]
SECTION = re.compile(r"^## (.*)$", flags=re.MULTILINE)
BUILD = [sys.executable, "-m", "hatchling", "build", "-d"]


def test_the_newest_section_of_the_changelog_is_the_version() -> None:
    sections = [Version(name) for name in SECTION.findall((ROOT / "CHANGELOG.md").read_text())]
    assert str(sections[0]) == __version__
    assert sections == sorted(set(sections), reverse=True)


def test_the_citation_is_that_at_the_foot_of_reports() -> None:
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    (author,) = cited["authors"]
    assert CITATION == f"{author['name']}. “{cited['title']}”, version {cited['version']}."
    assert CITATION in page_html(Page("A report", "Nothing.", ()), {})


def test_the_command_line_and_profiles_state_the_version(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["--version"])
    assert (ended.value.code, capsys.readouterr().out) == (0, f"taccel-lab {__version__}\n")
    block = Provenance(kind="assumed", method="none", source="none")
    assert block.tool_version == __version__


@pytest.mark.thorough
def test_archives_of_a_folder_without_git_bear_the_version(tmp_path: Path) -> None:
    """What a downloaded zip holds; the sdist's own wheel is what pip installs."""
    kept = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, check=True, capture_output=True)
    for name in kept.stdout.decode().split("\0"):
        if not name.startswith(("tests/", "docs/", "notebooks/", "benchmarks/")) and name:
            (tmp_path / "zip" / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, tmp_path / "zip" / name, follow_symlinks=False)
    subprocess.run([*BUILD, tmp_path, "-t", "sdist"], cwd=tmp_path / "zip", check=True)
    (archive,) = tmp_path.glob("*.tar.gz")
    assert archive.name == f"taccel_lab-{__version__}.tar.gz"
    with tarfile.open(archive) as members:
        members.extractall(tmp_path, filter="data")
    unpacked = tmp_path / archive.name.removesuffix(".tar.gz")
    subprocess.run([*BUILD, tmp_path, "-t", "wheel"], cwd=unpacked, check=True)
    assert [path.name for path in tmp_path.glob("*.whl")] == [
        f"taccel_lab-{__version__}-py3-none-any.whl"
    ]
