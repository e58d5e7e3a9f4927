# SPDX-License-Identifier: Apache-2.0
"""Where calibrations write: folders without a name of their own, and reports inside profiles."""

from __future__ import annotations

from pathlib import Path

import pytest

from taccel_lab.cli.app import main
from taccel_lab.cli.calibrate.base import report_folder
from taccel_lab.errors import InputError


def test_report_of_the_current_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "unit3" / "deep").mkdir(parents=True)
    monkeypatch.chdir(tmp_path / "unit3" / "deep")
    assert report_folder(Path("."), None) == tmp_path / "unit3" / "deep_report"
    assert report_folder(Path(".."), None) == tmp_path / "unit3_report"
    assert report_folder(Path("a/b"), None) == Path("a/b_report")
    assert report_folder(Path("."), Path("r")) == Path("r")
    with pytest.raises(InputError, match="cannot be a profile folder"):
        report_folder(Path("/"), None)


@pytest.mark.parametrize("report", ["profile", "profile/report", "x/../profile"])
def test_a_report_inside_the_profile_is_refused_before_any_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], report: str
) -> None:
    arguments = ["calibrate", "background", str(tmp_path / "captures"), "--out"]
    out = tmp_path / "profile"
    assert main([*arguments, str(out), "--report", str(tmp_path / report)]) == 2
    assert "would be inside the profile" in capsys.readouterr().err
    assert not out.exists()
