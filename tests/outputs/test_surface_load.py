# SPDX-License-Identifier: Apache-2.0
"""Contact pressure on faces of quadratic tets: the whole force, and the right peak."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from taccel_lab.geometry import Region
from taccel_lab.geometry.block import block_mesh
from taccel_lab.outputs import Outputs, SurfaceLoad
from taccel_lab.outputs.surface_load import SurfaceLoadReader
from taccel_lab.presses import PressEnv, PressSetup, parse_indenter
from taccel_lab.presses.mesh import PressMeshOptions, press_mesh
from taccel_lab.scene import Ball, Material, Scene, SoftBody
from taccel_lab.solvers import SolverConfig
from tests.support.variants import variants
from tests.verification.half_space import HalfSpace, half_space_mesh


def whole(load: SurfaceLoad) -> np.ndarray:
    return (load.tractions.numpy()[0] * load.areas.numpy()[0][:, None]).sum(axis=0)


def test_a_uniform_load_on_quadratic_faces_is_uniform() -> None:
    """With the shares of a contact, 19 of 20 parts at the middles; sides are not touched."""
    size = (1e-2, 2e-2, 3e-2)
    body = SoftBody(block_mesh((6, 6, 2), size, jitter=0.2), Material(1e5, 0.4))
    model = Scene(body).finalize()
    mesh = body.nodal_mesh
    top = mesh.region_nodes(Region.CONTACT)
    areas = model.surface.node_areas.numpy()[0]
    normal, drag = np.zeros((1, model.node_count, 3)), np.zeros((1, model.node_count, 3))
    # The contact weighs the nodes of the contact face alone, on its rim too.
    normal[0, top, 2] = -2e3 * areas[top]
    drag[0, top, 0] = 500 * areas[top]
    arrays = [wp.array(v, dtype=wp.vec3d) for v in (mesh.nodes_m[None], normal, drag)]
    load = SurfaceLoadReader(model).read(*arrays)
    np.testing.assert_allclose(whole(load), (normal + drag)[0].sum(axis=0), rtol=1e-13, atol=1e-15)
    inner = top[(np.abs(mesh.nodes_m[top, :2]) < 0.24 * np.array(size[:2])).all(axis=1)]
    assert len(inner) > 20
    # Twenty parts of a corner's share are not exactly none: neighbours differ in size.
    np.testing.assert_allclose(load.pressures.numpy()[0, inner], 2e3, rtol=0.05)


@pytest.mark.thorough
@pytest.mark.parametrize("cells", variants([2], [2, 3]))
def test_hertz_peak_and_the_whole_force(cells: int) -> None:
    radius, depth = 1e-2, 2.5e-5
    contact = np.sqrt(radius * depth)
    space = HalfSpace(
        half_space_mesh(contact, cells, 100 * contact, float(np.exp(1.2 / cells))),
        Ball(radius),
        young_pa=1e5,
        poisson=0.3,
        start_m=radius + 0.1 * depth,
        dhat_m=0.01 * depth,
        absolute_tolerance_n=1e-12,
    )
    space.move(0.0, radius - depth)
    load = Outputs(space.solver).update(space.state).surface_load
    force = space.normal_n.sum(axis=0)
    soft = slice(0, space.model.soft_count)
    carried = load.tractions.numpy()[0, soft] * load.areas.numpy()[0, soft, None]
    np.testing.assert_allclose(carried.sum(axis=0), force, atol=1e-13 * np.abs(force[2]))
    size = np.linalg.norm(space.normal_n, axis=1)
    r_sq = (space.positions_m[:, :2] ** 2).sum(axis=1)
    a_sq = 2.5 * (size * r_sq).sum() / size.sum()
    peak = 1.5 * size.sum() / (np.pi * a_sq)
    pressure = load.pressures.numpy()[0, soft]
    assert pressure.max() == pytest.approx(peak, rel=0.05)
    assert pressure.min() >= 0
    # Force over nodal area is none: corners have next to nothing, middles a quarter too much.
    on_top = (space.areas_m2 > 0) & (space.rest_m[:, 2] > -0.1 * depth)
    inside = on_top & (r_sq < 0.25 * a_sq)
    raw = size[inside] / load.areas.numpy()[0, soft][inside]
    assert raw.min() < 0.4 * peak and raw.max() > 1.2 * peak
    expected = peak * np.sqrt(1 - r_sq[inside] / a_sq)
    error = pressure[inside] / expected - 1
    assert np.sqrt((error**2).mean()) < 0.4 / cells**2 + 0.01


@pytest.mark.thorough
def test_pressure_on_a_bonded_pad_is_that_of_a_fine_mesh() -> None:
    at_mm, depth_mm = (1.0, -0.5), 0.4

    def peak(options: PressMeshOptions) -> tuple[float, np.ndarray, np.ndarray]:
        mesh = press_mesh("gelsight", {}, at_mm, 0.85, options)
        gel, ball = Material(1.5e5, 0.46), parse_indenter("sphere:2.0")
        config = SolverConfig(dhat_m=5e-6)
        env = PressEnv(PressSetup(mesh, gel, ball), np.array([at_mm]), config=config)
        env.move_to(depth_mm)
        load = Outputs(env.solver).update(env.state).surface_load
        soft = slice(0, env.model.soft_count)
        pressure, area = load.pressures.numpy()[0, soft], load.areas.numpy()[0, soft]
        force = np.linalg.norm(env.contact_forces[0], axis=1)
        x = env.positions[0]
        weight = area * pressure
        return float(pressure.max()), weight @ x / weight.sum(), force @ x / force.sum()

    coarse, found, true = peak(PressMeshOptions(3.0, core=4, rings=8))
    fine, _, _ = peak(PressMeshOptions(6.0, core=6, rings=11))
    assert coarse == pytest.approx(fine, rel=0.05)
    np.testing.assert_allclose(found[:2], true[:2], atol=2e-6)
