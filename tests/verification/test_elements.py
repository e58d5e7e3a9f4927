# SPDX-License-Identifier: Apache-2.0
"""Linear and quadratic tets: patch test, bending, convergence, locking; quadratic gels at work."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import warp as wp

from taccel_lab.cad.mesh.focus import FocusOptions
from taccel_lab.cad.mesh.gel_mesh import focused_gel_mesh
from taccel_lab.cad.parts.gel_pad import GelPad
from taccel_lab.geometry import PixelGrid, Region
from taccel_lab.presses import PHYSICS, Accuracy, PressEnv, PressSetup, parse_indenter
from taccel_lab.scene import Element, KinematicBody, Material, MaterialModel, Scene, SoftBody
from taccel_lab.signals import SignalTactile
from taccel_lab.solvers.step_report import EnvStatus
from tests.support.blocks import block_mesh, pose
from tests.support.scene_steps import Stepped, Watched, in_time, linear
from tests.verification.curved_tets import CURVED, curved
from tests.verification.element_problems import (
    COOK_ENERGY,
    cook_error,
    rate,
    referee,
    surface_load,
    swirl_error,
    whole_faces,
)
from tests.verification.elements import ElementForces
from tests.verification.test_press import COARSE as MESH

YOUNG = 1e5


def held(element: Element, law: MaterialModel, poisson: float) -> ElementForces:
    """A block of distorted tets, held at all its outer nodes."""
    mesh = block_mesh((3, 3, 3), (3e-3, 3e-3, 3e-3), jitter=0.25, seed=2)
    ratio = 0.3 if law is MaterialModel.MOONEY_RIVLIN else 0.0
    material = Material(YOUNG, poisson, model=law, mooney_ratio=ratio)
    return ElementForces(
        Scene(SoftBody(mesh, material, np.unique(mesh.faces), element=element)).finalize()
    )


def found_from_off(forces: ElementForces, exact: np.ndarray, tolerance_n: float) -> tuple:
    start, inner = exact.copy(), forces.free
    start[inner] += np.random.default_rng(0).uniform(-3e-5, 3e-5, (len(inner), 3))
    return forces.equilibrium(np.zeros_like(exact), start=start, tolerance_n=tolerance_n)


@pytest.mark.parametrize("poisson", [0.3, 0.499])
@pytest.mark.parametrize("law", list(MaterialModel))
@pytest.mark.parametrize("element", list(Element))
def test_patch(element: Element, law: MaterialModel, poisson: float) -> None:
    """Outside nodes on an affine map: all forces inside vanish on it, and it is what is found."""
    forces = held(element, law, poisson)
    rest = forces.model.rest_positions.numpy()[0]
    f = np.array([[1.06, 0.08, -0.03], [0.02, 0.97, 0.05], [-0.06, 0.04, 1.02]])
    if law is MaterialModel.ST_VENANT_KIRCHHOFF:
        f = np.eye(3) + 0.2 * (f - np.eye(3))  # it is not stable under strong compression
    # A pressure of a third of Young's modulus, also where the solid is all but incompressible.
    f *= (1 + 3 * (1 - 2 * poisson) * 0.3) ** (1 / 3) / np.linalg.det(f) ** (1 / 3)
    exact = rest @ f.T + [1e-3, -2e-3, 5e-4]
    gradient = forces.gradient(exact[None])[0]
    scale = np.abs(gradient).max()
    assert scale > 1e-3
    assert np.abs(gradient[forces.free]).max() < 1e-12 * scale
    assert len(forces.free) > (7 if element is Element.LINEAR else 100)
    found, _ = found_from_off(forces, exact, 1e-11 * scale)
    np.testing.assert_allclose(found, exact, atol=1e-12 * np.ptp(exact))


@pytest.mark.parametrize("growth", [-0.004, 0.04])
def test_an_even_pressure_does_not_slow_newton(growth: float) -> None:
    """At nu = 0.499 a volume change of 4 % is a pressure of 7 Young's moduli, 20 shear moduli."""
    forces = held(Element.QUADRATIC, MaterialModel.NEO_HOOKEAN, 0.499)
    exact = forces.model.rest_positions.numpy()[0] * (1 + growth) ** (1 / 3)
    found, iterations = found_from_off(forces, exact, 1e-10)
    np.testing.assert_allclose(found, exact, atol=1e-11 * np.ptp(exact))
    assert iterations <= 12


@pytest.mark.parametrize("element", list(Element))
@pytest.mark.parametrize("poisson", [0.3, 0.499])
def test_thick_beam_in_bending(element: Element, poisson: float) -> None:
    """Against Timoshenko: two quadratic cells in the height are enough, four linear are not."""
    length, height = 8e-3, 1e-3
    cells = (32, 4, 4) if element is Element.LINEAR else (16, 2, 2)
    mesh = block_mesh(cells, (length, height, height))
    # Held at one end; the tip carries an even shear.
    left = np.flatnonzero(mesh.nodes_m[:, 0] < -length / 2 + 1e-12)
    body = SoftBody(mesh, Material(YOUNG, poisson), left, element=element)
    forces = ElementForces(Scene(body).finalize())
    full = body.nodal_mesh
    faces = whole_faces(full)
    tip = (full.nodes_m[faces[:, :3], 0] > length / 2 - 1e-12).all(axis=1)
    load = surface_load(full, faces[tip], lambda x: np.tile([0, 0, 1.0], (len(x), 1)))
    assert load.sum(axis=0)[2] == pytest.approx(height**2, rel=1e-12)
    move = forces.linear_response(load)
    end = np.unique(faces[tip])
    found = move[end, 2].mean()
    force, inertia = height**2, height**4 / 12
    shear = YOUNG / (2 * (1 + poisson))
    factor = 10 * (1 + poisson) / (12 + 11 * poisson)  # Cowper 1966, rectangle
    beam = force * length**3 / (3 * YOUNG * inertia) + force * length / (factor * shear * height**2)
    if element is Element.QUADRATIC:
        assert found == pytest.approx(beam, rel=0.025)
    else:
        assert found < (0.85 if poisson == 0.3 else 0.5) * beam


@pytest.mark.thorough
def test_smooth_fields_converge_with_the_order_of_the_element() -> None:
    """In L2: second order for linear tets, third for quadratic ones, near nu = 0.5 too."""
    for poisson, least in ((0.3, 2.5), (0.499, 2.4)):
        cells = [2, 4, 6]
        errors = [swirl_error(Element.QUADRATIC, n, poisson) for n in cells]
        assert rate(cells, errors) > least
        assert errors[-1] < 0.06
    assert swirl_error(Element.LINEAR, 8, 0.3) < 0.25
    assert swirl_error(Element.LINEAR, 8, 0.499) > 0.9


@pytest.mark.thorough
def test_cooks_membrane() -> None:
    """With some 240 nodes quadratic tets are within 2 %; linear ones of 2,200 nodes lock."""
    for poisson, close in ((0.3, 0.01), (0.49, 0.02), (0.499, 0.02)):
        cells = [2, 4, 8]
        errors = [cook_error(Element.QUADRATIC, n, poisson) for n in cells]
        assert errors[0] < errors[1] < errors[2] < 0
        assert abs(errors[1]) < close
        assert rate(cells, errors) > 1.7
    # Referee by another programme: quadratic tets go to it.
    assert abs(cook_error(Element.QUADRATIC, 16, 0.3)) < 1.5e-3
    assert cook_error(Element.LINEAR, 32, 0.3) > -0.05
    assert cook_error(Element.LINEAR, 32, 0.499) < -0.5


@pytest.mark.slow
@pytest.mark.parametrize("poisson", COOK_ENERGY)
def test_the_referee_of_cooks_membrane(poisson: float) -> None:
    pytest.importorskip("skfem")
    assert referee(poisson) == pytest.approx(COOK_ENERGY[poisson], abs=2e-4)


def layer_press(element: Element, layers: int, poisson_ratio: float) -> tuple[int, list[float]]:
    """Nodes, and forces [N] of a ball 0.2, 0.6 and 1 mm deep in an evenly refined bonded gel."""
    pad = GelPad(24.0, 24.0, 1.5, thickness_mm=4.25, window_x_mm=18.0, window_y_mm=18.0)
    rings = max(5, round(2.3 * layers))
    focus = FocusOptions((0.0, 0.0), 3.5, 1.4 / layers, 2 * layers, rings, layers, layer_ratio=1.15)
    physics = replace(PHYSICS[Accuracy.DEFAULT], element=element)
    gel, ball = Material(1.5e5, poisson_ratio), parse_indenter("sphere:4.0")
    env = PressEnv(
        PressSetup(focused_gel_mesh(pad, focus), gel, ball, physics=physics), np.zeros((1, 2))
    )
    forces = []
    for depth in (0.2, 0.6, 1.0):
        env.move_to(depth)
        forces.append(float(env.wrench[0, 2]))
    return env.model.soft_count, forces


@pytest.mark.slow
@pytest.mark.parametrize("poisson", [0.45, 0.499])
def test_force_of_a_bonded_layer(poisson: float) -> None:
    """Force over depth of a ball on a bonded layer: within 3 % on the coarsest quadratic mesh."""
    (count, coarse), (_, fine) = (layer_press(Element.QUADRATIC, n, poisson) for n in (2, 3))
    # The next mesh, of 12,969 nodes, moves the last force of ``fine`` by 0.4 %.
    assert count < 2100
    np.testing.assert_allclose(coarse[1:], fine[1:], rtol=0.03)
    linear_count, linear = layer_press(Element.LINEAR, 4, poisson)
    assert linear_count == pytest.approx(count, rel=0.1)
    assert linear[-1] > (1.15 if poisson == 0.45 else 5) * fine[-1]


def test_gels_of_unlike_elements_press_on_each_other() -> None:
    mesh = block_mesh((4, 4, 2), (4e-3, 4e-3, 2e-3), jitter=0.1)
    upper = linear(mesh, Material(2e5, 0.4), name="upper", mount="hand")
    gels = [SoftBody(MESH, Material(1e5, 0.45)), upper]
    made = Scene(gels, KinematicBody(None, name="hand"))
    path = [pose(0, 0, gap, (1, 0.02, 0), 180) for gap in (3e-4, -1e-4, -3e-4)]
    run = Watched(made, path[0])
    assert len(run.model.elastic) == 2
    run.walk(path[1:])
    first, second = run.force(0), run.force(1)
    assert abs(first[2]) > 1e-2
    np.testing.assert_allclose(first, -second, atol=1e-12 * np.abs(run.contact()).sum())


def test_signals_read_all_nodes_of_the_surface() -> None:
    """The height map of a paraboloid through the nodes: middles are part of the surface."""
    mesh = SoftBody(MESH, Material(1e5, 0.45)).nodal_mesh
    x = mesh.nodes_m.copy()
    on_top = mesh.region_nodes(Region.CONTACT)
    x[on_top, 2] -= 10.0 * (x[on_top, :2] ** 2).sum(axis=1)
    grid = PixelGrid(40, 30, 0.1, 0.1)
    x_mm, y_mm = np.meshgrid(grid.x_mm(), grid.y_mm())
    height = -10.0 * 1e-6 * (x_mm**2 + y_mm**2)
    errors = []
    for gel_mesh, nodes in ((mesh, x), (MESH, x[: MESH.node_count])):
        reader = SignalTactile(gel_mesh, grid, env_count=1)
        reader.update(wp.array(nodes[None], dtype=wp.vec3d, device="cpu"))
        errors.append(np.abs(reader.height_m.numpy()[0] - height).max())
    assert errors[0] < 0.3 * errors[1]
    assert errors[0] < 2e-6


@pytest.mark.parametrize("law", list(MaterialModel))
def test_a_tet_inside_out_between_its_corners_is_no_result(law: MaterialModel) -> None:
    """Held nodes bend one tet; no corner, no quadrature point and no energy tells."""
    soft = SoftBody(CURVED, Material(1e5, 0.3, model=law), np.arange(4), element=Element.QUADRATIC)
    run = Stepped(Scene(soft, time=in_time(1e-5, 0.0), env_count=2))
    # The second environment bends it a little only.
    start = run.state.positions.numpy() + np.stack([curved(soft), curved(soft, 0.2)])
    run.state.positions.assign(start)
    report = run.attempt()
    # A material that bears inversion may start so; then nothing was lost by the step.
    bears = law in (MaterialModel.STABLE_NEO_HOOKEAN, MaterialModel.ST_VENANT_KIRCHHOFF)
    first = EnvStatus.CONVERGED if bears else EnvStatus.INVERSION
    assert [EnvStatus(status) for status in report.status] == [first, EnvStatus.CONVERGED]
    if not bears:
        np.testing.assert_array_equal(run.x(), start[0])
