# SPDX-License-Identifier: Apache-2.0
"""fTetWild meshes of pads, their regions, and the cache that keeps them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cad.mesh import cache
from cad.mesh.quality import measure_quality, require_quality
from cad.mesh.regions import transfer_regions
from cad.mesh.even import even_gel_mesh
from cad.mesh.surface import check_closed
from cad.mesh.tessellate import tessellate_solid
from cad.mesh.tetrahedralize import tetwild_gel_mesh
from cad.parts.gel_pad import GelPad
from cad.parts.gel_pad_solid import gel_pad_solid
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(cache.CACHE_VARIABLE, str(tmp_path / "cache"))


@given(
    st.sampled_from([0.0, 40.0]), st.sampled_from(["none", "chamfer", "fillet"]), st.floats(2, 3)
)
@settings(
    max_examples=2, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_tetwild_meshes_are_sound(crown_mm: float, rim: str, thickness_mm: float) -> None:
    pad = GelPad(
        length_x_mm=10, length_y_mm=8, corner_radius_mm=1.5, thickness_mm=thickness_mm,
        crown_radius_x_mm=crown_mm, crown_radius_y_mm=crown_mm, rim=rim, rim_mm=0.4,
        window_x_mm=6, window_y_mm=4,
    )  # fmt: skip
    part = gel_pad_solid(pad)
    mesh = tetwild_gel_mesh(pad, 1.8, epsilon=5e-3, part=part, use_cache=False)
    assert (mesh.volumes_m3() > 0).all()
    check_closed(mesh.faces, "boundary")
    quality = measure_quality(mesh, pad, cad_volume_mm3=part.solid.volume)
    require_quality(mesh, quality)
    assert np.unique(mesh.nodes_m[mesh.bonded_nodes(), 2]).size == 1
    assert quality.back_plane_error_mm < 1e-12
    assert quality.volume_error_percent == pytest.approx(0, abs=2)
    for region, tolerance in ((Region.CONTACT, 0.06), (Region.SIDE, 0.06), (Region.WINDOW, 0.35)):
        measured = quality.region_areas_mm2[region.name.lower()]
        assert measured == pytest.approx(part.area_mm2(region), rel=tolerance)
    outside = Path("__tracked_surface.stl")
    assert not outside.exists()


@pytest.mark.parametrize("rim", ["none", "chamfer", "fillet"])
def test_regions_of_a_known_mesh_are_recovered(rim: str) -> None:
    pad = GelPad(rim=rim, crown_radius_x_mm=80, crown_radius_y_mm=80)
    mesh = even_gel_mesh(pad, 1.2)
    surface = tessellate_solid(gel_pad_solid(pad))
    found = transfer_regions(mesh.nodes_m * 1e3, mesh.faces, surface)
    assert (found == mesh.face_regions).mean() > 0.995


def test_second_request_comes_from_the_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    pad = GelPad(
        length_x_mm=6, length_y_mm=6, corner_radius_mm=1, thickness_mm=2, window_x_mm=4,
        window_y_mm=4,
    )  # fmt: skip
    first = tetwild_gel_mesh(pad, 1.5, epsilon=5e-3)
    monkeypatch.setattr("cad.mesh.tetrahedralize._mesh", None)
    second = tetwild_gel_mesh(pad, 1.5, epsilon=5e-3)
    assert first.nodes_m.tobytes() == second.nodes_m.tobytes()
    assert np.array_equal(first.face_regions, second.face_regions)
    with pytest.raises(TypeError):
        tetwild_gel_mesh(pad, 1.4, epsilon=5e-3)


def test_damaged_cache_is_reported_and_rebuilt() -> None:
    pad = GelPad()
    built = []

    def build():
        built.append(1)
        return even_gel_mesh(pad, 2.0)

    cache.cached_mesh({"a": 1.0}, build)
    (stored,) = (cache.cache_folder() / "meshes").glob("*.npz")
    stored.write_bytes(stored.read_bytes()[:1000])
    with pytest.warns(UserWarning, match="damaged"):
        mesh = cache.cached_mesh({"a": 1.0}, build)
    assert len(built) == 2 and mesh.node_count > 0
    assert cache.cached_mesh({"a": 1.0}, build).tets.tobytes() == mesh.tets.tobytes()
    assert len(built) == 2


def test_keys_follow_content() -> None:
    a = np.arange(6.0)
    key = cache.content_key({"x": a, "n": 1})
    assert key == cache.content_key({"n": 1, "x": a.copy()})
    assert key != cache.content_key({"x": a.reshape(2, 3), "n": 1})
    assert key != cache.content_key({"x": a + 1e-9, "n": 1})
    assert key != cache.content_key({"x": a, "n": 2})


def test_unwritable_cache_names_the_variable(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("")
    monkeypatch.setenv(cache.CACHE_VARIABLE, str(blocked))
    with pytest.raises(InputError, match=cache.CACHE_VARIABLE):
        cache.cached_mesh({}, lambda: even_gel_mesh(GelPad(), 2.0))


@pytest.mark.parametrize(("edge_mm", "epsilon"), [(0.0, 1e-3), (99.0, 1e-3), (1.0, 0.5)])
def test_bad_options_are_refused(edge_mm: float, epsilon: float) -> None:
    with pytest.raises(InputError, match="allowed"):
        tetwild_gel_mesh(GelPad(), edge_mm, epsilon=epsilon)
