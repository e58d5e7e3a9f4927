# SPDX-License-Identifier: Apache-2.0
"""Standard presses: their paths, what is refused, and the jobs that they become."""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any

import numpy as np
import pytest

from taccel_lab.envs import parse_indenter
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.sensors.gelsight.family import GelSightParameters
from taccel_lab.sensors.press_mesh import press_mesh
from taccel_lab.studies.press_job import place_mm, press_jobs
from taccel_lab.studies.presses import (
    DEFAULT_PRESSES,
    STANDARD_PRESSES,
    StandardPress,
    standard_presses,
)
from tests.studies.quick import COARSE, coarse, jobs


def test_the_standard_six() -> None:
    assert DEFAULT_PRESSES == ("sphere", "punch", "cylinder", "edge", "grating", "shear")
    assert [press.name for press in standard_presses()] == list(DEFAULT_PRESSES)
    assert standard_presses(["pairs"]) == [STANDARD_PRESSES["pairs"]]
    with pytest.raises(InputError, match="no press 'ball'; known: sphere, punch"):
        standard_presses(["ball"])


@pytest.mark.parametrize("press", STANDARD_PRESSES.values(), ids=lambda press: press.name)
def test_paths(press: StandardPress) -> None:
    path = press.waypoints()
    assert [point.depth for point in path[: press.steps]] == pytest.approx(
        np.arange(1, press.steps + 1) / press.steps
    )
    for a, b in itertools.pairwise(path):
        assert 0 <= b.depth <= 1 and abs(b.shear - a.shear) <= 1 / press.shear_steps + 1e-12
    assert path[-1].depth == (0.0 if press.release else 1.0)
    assert max(point.shear for point in path) == (1.0 if press.shear_fraction else 0.0)
    assert path[-1].twist == (1.0 if press.twist_deg else 0.0)


def test_shear_goes_back_before_the_twist() -> None:
    path = dataclasses.replace(STANDARD_PRESSES["shear"], shear_steps=2, twist_steps=1).waypoints()
    after = [(point.shear, point.twist) for point in path[-5:]]
    assert after == [(0.5, 0), (1.0, 0), (0.5, 0), (0.0, 0), (0.0, 1.0)]


def test_depth_follows_the_thickness_up_to_the_limit() -> None:
    press = dataclasses.replace(STANDARD_PRESSES["sphere"], depth_fraction=0.4, depth_limit_mm=2.0)
    assert press.full_depth_mm(1.5) == pytest.approx(0.6)
    assert press.full_depth_mm(50.0) == 2.0
    fixed = dataclasses.replace(press, depth_fraction=0.0, depth_mm=0.3)
    assert fixed.full_depth_mm(1.5) == fixed.full_depth_mm(10.0) == 0.3


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"name": "a b"}, "must be a word"),
        ({"indenters": ()}, "at least one indenter"),
        ({"indenters": ("ball:3",)}, "not understood"),
        ({"places": ()}, "at least one indenter and one place"),
        ({"places": ((2.0, 0.0),)}, "in \\[-1, 1\\]"),
        ({"depth_mm": 1.0}, "either depth_fraction or depth_mm"),
        ({"depth_fraction": 0.0}, "either depth_fraction or depth_mm"),
        ({"depth_fraction": 0.9}, "depth_fraction must lie in"),
        ({"depth_limit_mm": 0.0}, "depth_limit_mm must be above 0"),
        ({"twist_deg": 180.0}, "twist_deg must lie in"),
        ({"shear_fraction": float("nan")}, "shear_fraction must lie in"),
        ({"steps": 0}, "steps must lie in 1..200, got 0"),
    ],
)
def test_bad_presses(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        dataclasses.replace(STANDARD_PRESSES["sphere"], **changes)


def test_places_are_parts_of_the_view() -> None:
    grid = PixelGrid(101, 51, 0.1, 0.2, center_u_px=40)
    assert place_mm(grid, (0, 0)) == pytest.approx((1.0, 0.0))
    assert place_mm(grid, (1, -1)) == pytest.approx((6.0, -5.0))


def test_a_press_of_a_study_is_meshed_as_any_press() -> None:
    job = press_jobs(STANDARD_PRESSES["punch"], GelSightParameters())[0]
    pad = GelSightParameters().pad()
    outline = parse_indenter("cylinder:2").contact(0.15 * pad.thickness_mm)
    mesh = press_mesh("gelsight", {}, (0.0, 0.0), outline)
    assert np.array_equal(job.mesh.tets, mesh.tets)
    assert job.mesh.nodes_m == pytest.approx(mesh.nodes_m, abs=1e-12)


def test_a_press_goes_along_the_normal() -> None:
    job = jobs(coarse("sphere", places=((0.5, 0.0),)))[0]
    x = job.gel_from_press[0]
    assert x == pytest.approx(0.25 * 639 * 0.0295e-3)
    assert job.gel_from_press[2] == pytest.approx(np.sqrt(0.05**2 - x**2) - 0.05)
    assert 2 * np.arcsin(job.gel_from_press[4]) == pytest.approx(np.arcsin(x / 0.05))


def test_alike_designs_share_keys() -> None:
    press = coarse("sphere")
    first = jobs(press)[0]
    for alike in ({"young_modulus_mpa": 0.5}, {"density_kg_m3": 1500}, {"width_px": 641}):
        assert jobs(press, **alike)[0].key == first.key or "width_px" in alike
    for other in ({"thickness_mm": 4.0}, {"poisson_ratio": 0.4}, {"friction": 0.5}):
        assert jobs(press, **other)[0].key != first.key
    assert jobs(press, thickness_mm=4.0)[0].batch_key == first.batch_key
    assert jobs(press, friction=0.5)[0].batch_key != first.batch_key
    assert (
        jobs(coarse("sphere", mesh=dataclasses.replace(COARSE, core=6)))[0].batch_key
        != first.batch_key
    )
    assert jobs(coarse("sphere", steps=4))[0].batch_key != first.batch_key
    assert jobs(coarse("sphere", name="ball"))[0].key == first.key


def test_a_place_beside_the_pad_is_refused() -> None:
    parameters = GelSightParameters(length_x_mm=12.0, length_y_mm=12.0)
    with pytest.raises(InputError, match=r"beside the contact face|inside the pad"):
        press_jobs(coarse("sphere", places=((1.0, 1.0),)), parameters)
