# SPDX-License-Identifier: Apache-2.0
"""Blocks refuse what they must refuse, and say why."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta, timezone
from typing import Any

import pydantic
import pytest

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.profile import CameraBlock, ColorBlock, MaterialBlock, Provenance, SensorBlock


def material(provenance: Provenance, **changes: Any) -> MaterialBlock:
    values: dict[str, Any] = {
        "young_modulus_pa": 1e5,
        "poisson_ratio": 0.45,
        "density_kg_m3": 1000.0,
        "friction_coefficient": 0.5,
        "provenance": provenance,
    }
    return MaterialBlock(**{**values, **changes})


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("poisson_ratio", 0.5, "below 0.5.*incompressible"),
        ("poisson_ratio", 0.7, "below 0.5"),
        ("poisson_ratio", -0.1, "at least 0"),
        ("poisson_ratio", float("nan"), "finite"),
        ("young_modulus_pa", 0.0, r"must lie in \[2000, 5e\+07\] Pa, got"),
        ("young_modulus_pa", -1e5, r"must lie in \[2000, 5e\+07\] Pa, got"),
        ("young_modulus_pa", 1e12, r"must lie in \[2000, 5e\+07\] Pa, got 1e\+12"),
        ("young_modulus_pa", float("inf"), "finite"),
        ("young_modulus_pa", "soft", "valid number"),
        ("density_kg_m3", 0.0, "must lie in .* kg/m3, got 0"),
        ("friction_coefficient", -0.1, r"must lie in \[0, 5\], got -0\.1"),
        ("model", "linear", "neo_hookean"),
        ("stiffness", 3.0, "unknown key; allowed: .*young_modulus_pa"),
    ],
)
def test_material_refuses(provenance: Provenance, field: str, value: Any, words: str) -> None:
    with pytest.raises(InputError, match=rf"material\.{field}: .*{words}"):
        material(provenance, **{field: value})


@pytest.mark.parametrize("poisson_ratio", [0.0, 0.4999])
def test_material_accepts_the_open_interval(provenance: Provenance, poisson_ratio: float) -> None:
    assert material(provenance, poisson_ratio=poisson_ratio).poisson_ratio == poisson_ratio


def test_all_wrong_keys_are_named_at_once(provenance: Provenance) -> None:
    with pytest.raises(InputError) as caught:
        material(provenance, poisson_ratio=0.6, density_kg_m3=-1.0)
    assert "poisson_ratio" in str(caught.value)
    assert "density_kg_m3" in str(caught.value)


def test_nested_keys_are_named_by_path() -> None:
    wrong: Any = {"kind": "assumed", "method": "m", "source": "s", "inputs": {"a.png": "123"}}
    with pytest.raises(InputError, match=r"material\.provenance\.inputs\.a\.png"):
        material(wrong)


def test_blocks_are_frozen_and_replace_checks(provenance: Provenance) -> None:
    block = material(provenance)
    with pytest.raises(pydantic.ValidationError, match="frozen"):
        block.poisson_ratio = 0.4  # type: ignore[misc]
    assert block.replace(poisson_ratio=0.4).poisson_ratio == 0.4
    assert block.poisson_ratio == 0.45
    with pytest.raises(InputError, match="poisson_ratio"):
        block.replace(poisson_ratio=0.5)


def test_calibrated_blocks_must_carry_their_evidence() -> None:
    with pytest.raises(pydantic.ValidationError, match="must name its inputs"):
        Provenance(kind="calibrated", method="fit", source="captures")


def test_valid_region_must_be_an_interval() -> None:
    with pytest.raises(pydantic.ValidationError, match=r"depth_mm: 2.0 > 1.0"):
        Provenance(kind="assumed", method="m", source="s", valid_region={"depth_mm": (2.0, 1.0)})


def test_creation_time_is_utc() -> None:
    east = datetime(2026, 1, 1, tzinfo=timezone(timedelta(hours=2)))
    with pytest.raises(pydantic.ValidationError, match="UTC"):
        Provenance(kind="assumed", method="m", source="s", created=east)
    stamp = Provenance(kind="assumed", method="m", source="s").created
    assert stamp.tzinfo is UTC
    assert abs(datetime.now(UTC) - stamp) < timedelta(minutes=1)


def test_configuration_values_keep_their_types(provenance: Provenance) -> None:
    values = {"count": 2, "scale": 2.0, "flag": True, "word": "2", "mixed": [1, 2.5, "x", False]}
    block = SensorBlock(name="n", family="f", parameters=values, provenance=provenance)
    assert [type(value) for value in block.parameters.values()] == [int, float, bool, str, list]
    mixed = block.parameters["mixed"]
    assert isinstance(mixed, list)
    assert [type(value) for value in mixed] == [int, float, str, bool]


def test_architecture_refuses_objects(provenance: Provenance) -> None:
    with pytest.raises(InputError, match=r"color\.architecture"):
        ColorBlock(architecture={"layer": {"width": 3}}, provenance=provenance)  # type: ignore[dict-item]


def test_camera_block_round_trips_the_grid(provenance: Provenance) -> None:
    grid = PixelGrid(640, 480, 0.0295, 0.03, center_u_px=310.5, center_v_px=240.0)
    assert CameraBlock.from_grid(grid, provenance).grid() == grid
