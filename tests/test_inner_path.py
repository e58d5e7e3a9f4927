# SPDX-License-Identifier: Apache-2.0
"""Whatever a file names lies in its folder, or is refused with a sentence."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.errors import InputError
from taccel_lab.inner_path import inner_path

PARTS = st.sampled_from(
    ["..", ".", "a", "b c", "", "~", "*", "..a", "a..", "C:", "\\", "é", "\ud800", "\0"]
)


@given(parts=st.lists(PARTS, max_size=6), separator=st.sampled_from(["/", "//", "\\"]))
def test_no_name_leads_out(parts: list[str], separator: str) -> None:
    folder = Path("/some/folder")
    try:
        path = inner_path(folder, separator.join(parts))
    except InputError as error:
        assert str(error).startswith("/some/folder: ")
    else:
        assert path.resolve().is_relative_to(folder.resolve())


def test_names_that_no_file_can_have(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"cannot be followed: .*too long"):
        inner_path(tmp_path, "x" * 5000)
    with pytest.raises(InputError, match=r"file names cannot have '\\ud800'"):
        inner_path(tmp_path, "a\ud800b.png")


@pytest.mark.parametrize("name", ["a.png", "a/b.png", "..a", "a..b/c", "./a", "~", "a b"])
def test_ordinary_names_are_fine(tmp_path: Path, name: str) -> None:
    assert inner_path(tmp_path, name) == tmp_path / name


def test_links(tmp_path: Path) -> None:
    folder = tmp_path / "folder"
    folder.mkdir()
    (tmp_path / "secret").write_text("not yours")
    (folder / "out").symlink_to(tmp_path / "secret")
    (folder / "up").symlink_to(tmp_path)
    (folder / "round").symlink_to(folder / "round")
    (folder / "within").symlink_to(folder / "file")
    for name in ("out", "up/secret", "up"):
        with pytest.raises(InputError, match="is a link out of"):
            inner_path(folder, name)
    with pytest.raises(InputError, match="cannot be followed"):
        inner_path(folder, "round")
    assert inner_path(folder, "within") == folder / "within"
    # The folder itself may be reached by a link.
    (tmp_path / "shortcut").symlink_to(folder)
    assert inner_path(tmp_path / "shortcut", "within").name == "within"
