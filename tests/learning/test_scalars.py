# SPDX-License-Identifier: Apache-2.0
"""Scalars of trainings are there for TensorBoard where it is installed, or refused in words."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from taccel_lab.errors import InputError
from taccel_lab.learning.scalars import scalars_in


def test_no_folder_takes_no_scalars() -> None:
    with scalars_in(None) as write:
        write({"loss": 1.0}, 0)


def test_a_missing_tensorboard_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", None)
    with pytest.raises(InputError, match="pip install 'taccel-lab"), scalars_in(tmp_path / "out"):
        pass
    assert not (tmp_path / "out").exists()


def test_tensorboard_reads_what_was_written(tmp_path: Path) -> None:
    reader = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    with scalars_in(tmp_path / "out") as write:
        for step in (50, 100):
            write({"loss": 100.0 / step, "kl": 0.5}, step)
    found = reader.EventAccumulator(str(tmp_path / "out")).Reload()
    assert sorted(found.Tags()["scalars"]) == ["kl", "loss"]
    assert [(e.step, e.value) for e in found.Scalars("loss")] == [(50, 2.0), (100, 1.0)]
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"), scalars_in(tmp_path / "file"):
        pass
