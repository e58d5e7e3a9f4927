# SPDX-License-Identifier: Apache-2.0
"""What counts as a sensor, and what it says of itself."""

from __future__ import annotations

from pathlib import Path

import pytest

import taccel_lab as tl


def test_a_catalogue_name_with_parameters() -> None:
    profile = tl.load_sensor("flat_pad", {"thickness_mm": 3})
    assert profile.gel.thickness_mm == pytest.approx(3)
    text = repr(profile)
    assert text.startswith("profile of flat_pad\n") and "3 mm thick" in text
    assert len(text.splitlines()) < 25 and max(map(len, text.splitlines())) <= 110
    assert "<caption><b>profile of flat_pad</b></caption>" in profile._repr_html_()


def test_the_folder_of_a_profile(tmp_path: Path) -> None:
    tl.save_profile(tl.load_sensor("flat_pad"), tmp_path / "profile")
    assert repr(tl.load_sensor(tmp_path / "profile")) == repr(tl.load_sensor("flat_pad"))
    with pytest.raises(tl.InputError, match="change a sensor of the catalogue"):
        tl.load_sensor(tmp_path / "profile", {"thickness_mm": 3})


def test_a_step_file(tmp_path: Path) -> None:
    import build123d as bd

    bd.export_step(bd.Box(16, 12, 3), str(tmp_path / "gel.step"))
    faces = {"contact": ("plane:+z",), "bond": ("plane:-z",), "window": ("rect:10x8",)}
    profile = tl.load_sensor(tmp_path / "gel.step", {"young_modulus_mpa": 0.2}, **faces)
    assert profile.gel.thickness_mm == pytest.approx(3)
    assert profile.material.young_modulus_pa == pytest.approx(2e5)
    with pytest.raises(tl.InputError, match="touched: no option of a STEP file; there are contact"):
        tl.load_sensor(tmp_path / "gel.step", touched=("plane:+z",))
    with pytest.raises(tl.InputError, match="contact select faces of a STEP file"):
        tl.load_sensor("flat_pad", contact=("plane:+z",))
