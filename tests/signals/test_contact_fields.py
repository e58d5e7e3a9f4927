# SPDX-License-Identifier: Apache-2.0
"""Contact, traction and sliding on pixels: what the solver computed, and closed forms."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
import warp as wp

import taccel_lab as tl
from taccel_lab.geometry.block import block_mesh
from taccel_lab.signals.contact_fields import CONTACT_SIGNALS
from tests.verification.test_mindlin import BALL, DEPTH, MU, RADIUS, pressed_block, sliding

GRID = tl.PixelGrid(100, 80, 0.06, 0.06)
PIXEL_M2 = 0.06e-3**2
AT_MM = np.array([[0.0, 0.0], [0.5, 0.3]])


def block_env(cells: int, size_mm: float, envs: int = 1, **options: object) -> tl.PressEnv:
    """A block 4 mm thick under a ball of 4 mm."""
    mesh = block_mesh((cells, cells, max(2, cells // 4)), (size_mm * 1e-3, size_mm * 1e-3, 4e-3))
    gel, ball = tl.Material(1e5, 0.45), tl.parse_indenter("sphere:4")
    return tl.PressEnv(tl.PressSetup(mesh, gel, ball, **options), AT_MM[:envs])


@lru_cache
def dragged(device: str = "cpu") -> tl.PressEnv:
    """The ball 0.4 mm deep in two places, then dragged until its rim slips."""
    env = block_env(12, 9.0, 2, friction_coefficient=0.5, device=device)
    env.move_to(0.4)
    env.move_to(0.4, (0.1, 0.0))
    return env


def of(env: tl.PressEnv, **options: object) -> tl.SignalTactile:
    signal = tl.SignalTactile.from_solver(env.solver, GRID, **options)
    signal.update(env.state)
    return signal


@pytest.mark.thorough
def test_integrals_are_the_wrench():
    """Force and torque, from the pixels alone: traction by area of the surface, at its points."""
    env = dragged()
    names = ("traction_pa", "normals", "points_m", "pressure_pa", "height_m", "depth_m")
    traction, normals, points, pressure, height, depth = (
        array.numpy().astype(np.float64) for array in of(env).read(*names)
    )
    force = traction * (PIXEL_M2 / normals[..., 2:])
    total = force.sum(axis=(1, 2))
    wrench = tl.Outputs(env.solver).update(env.state).soft_wrenches().numpy()[:, 0]
    # Curved faces stand for flat ones between their nodes.
    most = np.abs(wrench[:, 2]).max()
    np.testing.assert_allclose(total, wrench[:, :3], atol=0.01 * most)
    torque = np.cross(points, force).sum(axis=(1, 2))
    np.testing.assert_allclose(torque, wrench[:, 3:], atol=1e-5 * most)
    assert (total[:, 0] > 0.01).all(), "the drag to +x is felt"
    assert pressure.min() == 0 and (traction[pressure == 0] == 0).all()
    np.testing.assert_allclose(depth, -height, atol=1e-9)
    np.testing.assert_array_equal(points[..., 2], height)
    x, y = np.meshgrid(1e-3 * GRID.x_mm(), 1e-3 * GRID.y_mm())
    np.testing.assert_allclose(points[0, ..., :2], np.stack([x, y], axis=-1), atol=1e-9)
    assert depth.max() == pytest.approx(0.4e-3, rel=0.03)


@pytest.mark.thorough
def test_contact_is_the_solver_s_and_not_a_threshold():
    """Elements are half as wide as the contact's radius: within a fifth of 6.0 mm2, which
    ``FineSurface`` finds on a mesh of three times as many nodes; pressures that are not zero
    reach over twice of it."""
    signal = of(dragged())
    slipping, contact, pressure = (
        signal.read(name)[0].numpy() for name in ("slipping", "contact", "pressure_pa")
    )
    np.testing.assert_allclose(contact.sum(axis=(1, 2)) * PIXEL_M2 * 1e6, 6.0, rtol=0.2)
    assert ((pressure > 0).sum(axis=(1, 2)) * PIXEL_M2 * 1e6 > 10).all()
    assert not (slipping & ~contact).any()
    assert (slipping.any(axis=(1, 2)) & ~slipping.all(axis=(1, 2))).all()


def test_a_gel_that_is_not_touched_feels_nothing():
    env = block_env(6, 12.0, friction_coefficient=0.5)
    env.move_to(-0.01)
    for array in of(env).read(*CONTACT_SIGNALS):
        assert not array.numpy().any()


@pytest.mark.thorough
def test_partial_slip_of_cattaneo_and_mindlin():
    """A ball pressed without and moved with friction; ``tests/verification/test_mindlin.py`` says
    where the closed form is from, and checks nodes where this looks at pixels."""
    block, load, full = pressed_block(2)
    a, count = RADIUS, block.model.soft_count
    before = block.positions_m.copy()
    block.move(0.6 * full, BALL - DEPTH)
    stick = (1 - block.friction_n[:, 0].sum() / (MU * load)) ** (1 / 3)
    assert 0.6 < stick < 0.8

    read = tl.Outputs(block.solver).update(block.state).sliding
    limits, slips = read.limits.numpy()[0, :count], read.slips.numpy()[0, :count]
    assert limits.sum() == pytest.approx(MU * load, rel=2e-3)
    behind = (block.positions_m - before)[:, 0] - 0.6 * full
    # Along the ball, which is flat to within a tenth of a degree.
    np.testing.assert_allclose(slips[limits > 0, 0], behind[limits > 0], atol=2e-3 * full)

    pitch_mm = 1e3 * a / 40
    grid = tl.PixelGrid(121, 121, pitch_mm, pitch_mm)
    signal = tl.SignalTactile.from_solver(block.solver, grid)
    signal.update(block.state)
    names = ("contact", "slipping", "slip_m", "traction_pa", "pressure_pa")
    contact, slipping, slip, traction, pressure = (a.numpy()[0] for a in signal.read(*names))
    x = (grid.x_mm()[None, :] - 600 * full) / (1e3 * a)
    r = np.hypot(x, grid.y_mm()[:, None] / (1e3 * a))
    # Nodes are 0.25 a apart.
    area = contact.sum() * (pitch_mm * 1e-3 / a) ** 2 / np.pi
    assert area == pytest.approx(1.0, abs=0.15)
    stuck = contact & ~slipping
    assert stuck[r < stick - 0.25].all() and not stuck[r > stick + 0.25].any()
    assert np.sqrt(stuck.sum() / contact.sum() * area) == pytest.approx(stick, abs=0.125)
    # The gel stays behind the ball, which goes to +x.
    for low, high in ((0.0, 0.4), (0.7, 0.8), (0.8, 0.9)):
        ring = contact & (r >= low) & (r < high)
        wanted = sliding(r[ring], stick).mean()
        assert -slip[ring, 0].mean() / full == pytest.approx(wanted, abs=0.04)
        assert abs(slip[ring, 1].mean()) / full < 0.01
    assert (slip[~contact] == 0).all()
    total = traction.sum(axis=(0, 1))
    assert total[0] / (MU * -total[2]) == pytest.approx(1 - stick**3, abs=0.01)
    assert pressure.sum() == pytest.approx(-total[2], rel=1e-3)


@pytest.mark.thorough
def test_chunks_and_chosen_environments_change_nothing():
    env, chosen = dragged(), np.array([False, True])
    whole = [array.numpy().copy() for array in of(env).read(*CONTACT_SIGNALS)]
    assert of(env, chunk_pixels=1).chunk_envs == 1
    for options in ({}, {"chunk_pixels": 1}):
        signal = of(env, **options)
        for who, rows in ((None, [0, 1]), (chosen, [1])):
            signal.update(env.state, who=who)
            for array, expected in zip(signal.read(*CONTACT_SIGNALS), whole, strict=True):
                np.testing.assert_array_equal(array.numpy(), expected[rows])


def test_what_is_missing_is_said():
    env = block_env(4, 12.0, 2, friction_coefficient=0.5)
    env.move_to(0.1)
    stateless = of(env)
    stateless.update(env.state.positions)
    bare = tl.SignalTactile(env.mesh, GRID, env_count=len(AT_MM))
    bare.update(env.state)
    smooth = block_env(4, 12.0)
    smooth.move_to(0.1)
    assert of(smooth).contact.numpy().any()
    outputs = tl.Outputs(smooth.solver).update(smooth.state)
    for call, words in (
        (lambda: stateless.read("contact"), r"contact needs the state of the solver: update\(st"),
        (lambda: bare.read("traction_pa"), "traction_pa needs the forces of a solver"),
        (lambda: of(env, gel=1), "there is no soft body 1; the scene has 1"),
        (lambda: of(smooth).read("slip_m"), "slip_m needs friction"),
        (lambda: outputs.sliding, "sliding needs friction"),
    ):
        with pytest.raises(tl.InputError, match=words):
            call()


@pytest.mark.gpu
@pytest.mark.skipif(not wp.is_cuda_available(), reason="needs a CUDA device")
def test_reads_can_be_captured_in_a_graph():
    """A graph that was captured at one step reads the next one as a plain read does."""
    env = dragged("cuda:0")
    signal = of(env)
    signal.read(*CONTACT_SIGNALS)
    with wp.ScopedCapture(env.model.device) as capture:
        signal.update(env.state)
        arrays = signal.read(*CONTACT_SIGNALS)
    env.move_to(0.4, (0.2, 0.0))
    wp.capture_launch(capture.graph)
    replayed = [array.numpy().copy() for array in arrays]
    signal.update(env.state)
    for found, array in zip(replayed, signal.read(*CONTACT_SIGNALS), strict=True):
        np.testing.assert_allclose(found, array.numpy(), rtol=1e-6, atol=1e-12)
    host = dragged()
    host.move_to(0.4, (0.2, 0.0))
    dragged.cache_clear()
    area = [a.contact.numpy().sum(axis=(1, 2)) for a in (of(env), of(host))]
    np.testing.assert_allclose(area[0], area[1], rtol=0.02)
