# SPDX-License-Identifier: Apache-2.0
"""Who has no newton is told so, and needs none for anything else."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from taccel_lab.cli import app
from taccel_lab.errors import InputError
from taccel_lab.newton_bridge import import_model, load_mjcf


def test_newton_is_asked_for(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "newton", None)
    path = tmp_path / "hand.xml"
    path.write_text("<mujoco/>", encoding="utf-8")
    for call in (lambda: import_model(None), lambda: load_mjcf(path)):
        with pytest.raises(InputError, match=r"pip install 'taccel-lab\[newton\]'"):
            call()
    assert app.main(["robot", "show", str(path)]) == 2
    assert "taccel-lab[newton]" in capsys.readouterr().err
