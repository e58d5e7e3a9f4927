# SPDX-License-Identifier: Apache-2.0
"""Files that one run holds."""

from __future__ import annotations

import errno
import fcntl
import os
from pathlib import Path
from typing import Any

import pytest

from taccel_lab.errors import InputError
from taccel_lab.files.file_lock import hold


def test_who_holds_a_file_is_named(tmp_path: Path) -> None:
    with open(tmp_path / "lock", "a+") as mine, open(tmp_path / "lock", "a+") as other:
        hold(mine, "it is taken", "wait")
        with pytest.raises(InputError, match=rf"it is taken \(process {os.getpid()} on .+\); wait"):
            hold(other, "it is taken", "wait")
    with open(tmp_path / "lock", "a+") as one, open(tmp_path / "lock", "a+") as two:
        hold(one, "", "", shared=True)
        hold(two, "", "", shared=True)


def test_a_file_system_without_locks_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing(*_: Any) -> None:
        raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS))

    monkeypatch.setattr(fcntl, "flock", missing)
    with (
        open(tmp_path / "lock", "a+") as file,
        pytest.raises(InputError, match=r"lock cannot be locked \(Function not implemented\).*NFS"),
    ):
        hold(file, "", "")
