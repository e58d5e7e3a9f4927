# SPDX-License-Identifier: Apache-2.0
"""An output folder that is replaced by others while it is looked at."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from taccel_lab.files import output_folder
from taccel_lab.files.output_folder import atomic_directory, require_replaceable


def test_a_folder_that_comes_between_is_not_taken_for_the_one_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """File systems give the number of a folder that is gone to the next one."""
    target = tmp_path / "out"
    with atomic_directory(target) as folder:
        (folder / "a.txt").write_text("one")
    real = output_folder.foreign_files
    looked = []

    def overtaken(folder: Path) -> list[str]:
        looked.append(folder)
        if len(looked) > 1:
            return real(folder)
        number = target.stat().st_ino
        kept = {path.name: path.read_bytes() for path in target.iterdir()}
        for _ in range(20):
            shutil.rmtree(target)
            target.mkdir()
            if target.stat().st_ino == number:
                break
        for name, content in kept.items():
            (target / name).write_bytes(content)
        return ["the marker of one, and a file of the other"]

    monkeypatch.setattr(output_folder, "foreign_files", overtaken)
    require_replaceable(target)
