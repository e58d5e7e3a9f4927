# SPDX-License-Identifier: Apache-2.0
"""Channels of a data set, of touches that are formulas: their units, and what patches add up to."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from taccel_lab.datasets.channels import channels_of, known_channels
from taccel_lab.geometry import PixelGrid

GRID = PixelGrid(48, 36, 0.1, 0.08, center_u_px=20.0, center_v_px=19.0)
CHANNELS = {channel.name: channel for channel in channels_of(tuple(known_channels()))}


class Touches(SimpleNamespace):
    """Two touches of a step, as ``TouchView`` shows them."""

    def __init__(self, **more: Any) -> None:
        streams: dict[int, list[int]] = {0: [], 1: []}

        def touch(env: int) -> SimpleNamespace:
            def rng(step: int, stream: int) -> np.random.Generator:
                streams[env].append(stream)
                return np.random.default_rng([env, step, stream])

            frame = np.array([0.0, 0, 0, 0, 0, 0, 1])
            noise = {"noise_levels": 2.0, "marker_noise_px": 0.5}
            return SimpleNamespace(rng=rng, friction=0.5, frame=frame, **noise)

        super().__init__(
            who=np.array([0, 1]), step=3, touches=[touch(0), touch(1)], streams=streams,
            camera=lambda env: GRID, sensor=SimpleNamespace(grid=GRID), **more,
        )  # fmt: skip


def test_patches_have_the_force_and_the_moment_of_the_nodes() -> None:
    """Of nodes between the middles of the outer patches."""
    rng = np.random.default_rng(0)
    columns, rows = 6, 4
    middles = np.stack(
        np.meshgrid((np.arange(columns) + 0.5) * 8 - 0.5, (np.arange(rows) + 0.5) * 9 - 0.5), -1
    )
    low, high = (1e-3 * GRID.gel_from_pixel(middles[at]) for at in ((0, 0), (-1, -1)))
    places = np.zeros((2, 20, 3))
    places[..., :2] = rng.uniform(low, high, (2, 20, 2))
    forces = rng.normal(size=(2, 20, 3))
    view = Touches(positions_m=places, forces_n=forces, patches=(columns, rows))
    found = CHANNELS["patch_forces_n"].read(view)  # type: ignore[arg-type]
    assert found.shape == (2, rows, columns, 3)
    np.testing.assert_allclose(found.sum(axis=(1, 2)), forces.sum(axis=1), atol=1e-12)
    arms = 1e-3 * GRID.gel_from_pixel(middles)
    moments = np.einsum("erci,rcj->eij", found, arms)
    np.testing.assert_allclose(moments, np.einsum("eni,enj->eij", forces, places[..., :2]))


@pytest.mark.parametrize(
    ("name", "of", "shape", "wanted"),
    [
        ("contact_area_mm2", "contact_area_m2", (2,), 1e6),
        ("node_pressures_kpa", "pressures_pa", (2, 5), 1e-3),
        ("node_tractions_kpa", "tractions_pa", (2, 5, 3), 1e-3),
    ],
)
def test_units_are_those_of_the_name(name, of, shape, wanted) -> None:
    values = np.random.default_rng(1).uniform(1, 2, shape)
    view = Touches(face_nodes=np.arange(5), **{of: values})
    np.testing.assert_allclose(CHANNELS[name].read(view), wanted * values)  # type: ignore[arg-type]


def test_errors_of_force_and_heights_are_in_newtons_and_millimetres() -> None:
    stated = {"force_n": np.array([0.1, 0.2]), "height_m": np.array([1e-5, 2e-5])}
    view: Any = Touches(errors=lambda name: stated[name])
    np.testing.assert_allclose(CHANNELS["force_error_n"].read(view), [0.1, 0.2])
    np.testing.assert_allclose(CHANNELS["height_error_mm"].read(view), [0.01, 0.02])


def test_levels_and_markers_have_noise_of_their_own() -> None:
    levels = np.full((2, 36, 48, 3), 100.0, dtype=np.float32)
    places = np.full((2, 4000, 2), 20.0)
    view: Any = Touches(levels=levels.copy(), markers_px=places, sent=lambda images: images)
    rgb, markers = (CHANNELS[name].read(view) for name in ("rgb", "markers_px"))
    assert view.streams == {0: [0, 1], 1: [0, 1]}
    np.testing.assert_allclose((rgb - 100).std(axis=(1, 2, 3)), np.hypot(2.0, 12**-0.5), rtol=0.05)
    np.testing.assert_allclose((markers - 20).std(axis=(1, 2)), 0.5, rtol=0.05)
    assert (places == 20.0).all()
