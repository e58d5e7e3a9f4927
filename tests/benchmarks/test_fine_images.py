# SPDX-License-Identifier: Apache-2.0
"""The suite ``fine_images``: its textures, gels and objects, and a row of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from taccel_lab.benchmarks import fine_images
from taccel_lab.benchmarks.command_line import main
from taccel_lab.benchmarks.results import read_result
from taccel_lab.benchmarks.textures import TEXTURES, carved_m
from taccel_lab.bodies.mesh_checks import check_edges


@pytest.mark.parametrize("name", TEXTURES)
def test_textures_are_repeated_without_a_jump(name: str) -> None:
    texture = TEXTURES[name]()
    assert texture.heights.min() == 0 and texture.heights.max() == 1
    x, y = np.meshgrid(np.linspace(-1e-3, 1e-3, 41), np.linspace(-1e-3, 1e-3, 43))
    carved = carved_m(texture, x, y)
    assert 0 <= carved.min() and carved.max() <= texture.depth_m
    np.testing.assert_allclose(carved_m(texture, x + texture.width_m, y), carved, atol=1e-12)
    tile = texture.width_m * texture.heights.shape[0] / texture.heights.shape[1]
    np.testing.assert_allclose(carved_m(texture, x, y - 2 * tile), carved, atol=1e-12)


def test_the_object_of_the_reference_is_closed() -> None:
    ball = fine_images.textured_ball(TEXTURES["knurl"]())
    check_edges(ball.vertices_m, ball.faces, "ball", closed=True)
    corners = ball.vertices_m[ball.faces]
    volume = np.einsum("fi,fi->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    assert volume > 0
    low = ball.vertices_m[:, 2].min()
    assert 0 <= low < 0.2 * TEXTURES["knurl"]().depth_m


@pytest.mark.parametrize("element_mm", [0.8, 0.35])
def test_gels_fill_the_pad(element_mm: float) -> None:
    mesh = fine_images.gel(element_mm)
    width, thickness = fine_images.PAD_MM
    assert mesh.volumes_m3().min() > 0
    assert mesh.volumes_m3().sum() == pytest.approx(1e-9 * width**2 * thickness, rel=1e-9)
    x = np.unique(np.round(1e3 * mesh.nodes_m[:, 0], 6))
    assert np.diff(x).min() == pytest.approx(element_mm, rel=0.3)
    with pytest.raises(Exception, match="--textures are knurl"):
        fine_images.FineImages(textures=("wood",)).measure_rows(None)  # type: ignore[arg-type]


@pytest.mark.slow
def test_a_row(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a reference that is not fine: the command, its figures and its picture."""
    monkeypatch.setenv("TACCEL_LAB_CACHE", str(tmp_path / "cache"))
    few = "--textures coin --elements-mm 0.8 0.5 --reference-mm 0.2 --out"
    assert main(["fine_images", *few.split(), str(tmp_path)]) == 0
    document = read_result(tmp_path / "fine_images.json")
    (row,) = document["rows"]
    coarse, finer = row["curve"]
    assert coarse["nodes"] < finer["nodes"] < row["reference"]["nodes"]
    for point in row["curve"]:
        for other in ("fused", "gel alone"):
            assert point["fine"]["levels_l1"] < 0.7 * point[other]["levels_l1"]
    assert finer["fine_force_n"] == pytest.approx(row["reference"]["force_n"], rel=0.15)
    assert document["mean"][1]["fine levels_l1"] == finer["fine"]["levels_l1"]
    assert (tmp_path / "fine_images.png").stat().st_size > 10_000
    again = read_result(tmp_path / "fine_images.json")
    assert again["complete"]
