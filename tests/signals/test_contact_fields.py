# SPDX-License-Identifier: Apache-2.0
"""Contact, traction and sliding on pixels: what the solver computed, and closed forms."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.geometry.block import block_mesh
from taccel_lab.outputs import Outputs
from taccel_lab.presses import PressEnv, parse_indenter
from taccel_lab.scene import Material
from taccel_lab.signals import SignalTactile
from taccel_lab.signals.contact_fields import CONTACT_SIGNALS
from tests.verification.test_mindlin import BALL, DEPTH, MU, RADIUS, pressed_block, sliding

GRID = PixelGrid(100, 80, 0.06, 0.06)
PIXEL_M2 = 0.06e-3**2
AT_MM = np.array([[0.0, 0.0], [0.5, 0.3]])


@lru_cache
def dragged(device: str = "cpu") -> PressEnv:
    """A ball of 4 mm, 0.4 mm deep in two places, then dragged until its rim slips."""
    mesh = block_mesh((12, 12, 3), (9e-3, 9e-3, 4e-3))
    env = PressEnv(
        mesh,
        Material(1e5, 0.45),
        parse_indenter("sphere:4"),
        AT_MM,
        friction_coefficient=0.5,
        device=device,
    )
    env.move_to(0.4)
    env.move_to(0.4, (0.1, 0.0))
    return env


def of(env: PressEnv, **options: object) -> SignalTactile:
    signal = SignalTactile.from_solver(env.solver, GRID, **options)
    signal.update(env.state)
    return signal


@pytest.mark.thorough
def test_integrals_are_the_wrench():
    """Force and torque, from the pixels alone: traction by area of the surface, at its points."""
    env = dragged()
    signal = of(env)
    traction, normals, points = (
        array.numpy().astype(np.float64)
        for array in signal.read("traction_pa", "normals", "points_m")
    )
    force = traction * (PIXEL_M2 / normals[..., 2:])
    total = force.sum(axis=(1, 2))
    wrench = Outputs(env.solver).update(env.state).soft_wrenches().numpy()[:, 0]
    # Curved faces stand for flat ones between their nodes.
    np.testing.assert_allclose(total, wrench[:, :3], atol=0.01 * np.abs(wrench[:, 2]).max())
    torque = np.cross(points, force).sum(axis=(1, 2))
    arm = 1e-5 * np.abs(wrench[:, 2]).max()
    np.testing.assert_allclose(torque, wrench[:, 3:], atol=arm)
    assert (total[:, 0] > 0.01).all(), "the drag to +x is felt"
    pressure = signal.pressure_pa.numpy()
    assert pressure.min() == 0
    beside = ~(pressure > 0)
    assert (traction[beside] == 0).all()
    height, depth = (array.numpy() for array in signal.read("height_m", "depth_m"))
    np.testing.assert_allclose(depth, -height, atol=1e-9)
    np.testing.assert_array_equal(points[..., 2], height.astype(np.float64))
    x, y = np.meshgrid(1e-3 * GRID.x_mm(), 1e-3 * GRID.y_mm())
    np.testing.assert_allclose(points[0, ..., :2], np.stack([x, y], axis=-1), atol=1e-9)
    assert depth.max() == pytest.approx(0.4e-3, rel=0.03)


@pytest.mark.thorough
def test_contact_is_the_solver_s_and_not_a_threshold():
    """Elements are half as wide as the contact's radius: within a fifth of 6.0 mm2, which
    ``FineSurface`` finds on a mesh of three times as many nodes; pressures that are not zero
    reach over twice of it."""
    signal = of(dragged())
    area = signal.contact.numpy().sum(axis=(1, 2)) * PIXEL_M2 * 1e6
    np.testing.assert_allclose(area, 6.0, rtol=0.2)
    assert ((signal.pressure_pa.numpy() > 0).sum(axis=(1, 2)) * PIXEL_M2 * 1e6 > 10).all()
    slipping = signal.slipping.numpy()
    assert not (slipping & ~signal.contact.numpy()).any()
    assert (slipping.any(axis=(1, 2)) & ~slipping.all(axis=(1, 2))).all()


def test_a_gel_that_is_not_touched_feels_nothing():
    mesh = block_mesh((6, 6, 2), (12e-3, 12e-3, 4e-3))
    env = PressEnv(
        mesh, Material(1e5, 0.4), parse_indenter("sphere:4"), AT_MM[:1], friction_coefficient=0.5
    )
    env.move_to(-0.01)
    for array in of(env).read(*CONTACT_SIGNALS):
        assert not array.numpy().any()


@pytest.mark.thorough
def test_partial_slip_of_cattaneo_and_mindlin():
    """A ball pressed without and moved with friction; ``tests/verification/test_mindlin.py`` says
    where the closed form is from, and checks nodes where this looks at pixels."""
    block, load, full = pressed_block(2)
    a = RADIUS
    before = block.positions_m.copy()
    block.move(0.6 * full, BALL - DEPTH)
    stick = (1 - block.friction_n[:, 0].sum() / (MU * load)) ** (1 / 3)
    assert 0.6 < stick < 0.8

    read = Outputs(block.solver).update(block.state).sliding
    limits = read.limits.numpy()[0, : block.model.soft_count]
    assert limits.sum() == pytest.approx(MU * load, rel=2e-3)
    behind = (block.positions_m - before)[:, 0] - 0.6 * full
    slips = read.slips.numpy()[0, : block.model.soft_count]
    # Along the ball, which is flat to within a tenth of a degree.
    np.testing.assert_allclose(slips[limits > 0, 0], behind[limits > 0], atol=2e-3 * full)

    pitch_mm = 1e3 * a / 40
    grid = PixelGrid(121, 121, pitch_mm, pitch_mm)
    signal = SignalTactile.from_solver(block.solver, grid)
    signal.update(block.state)
    contact, slipping, slip, traction, pressure = (
        array.numpy()[0]
        for array in signal.read("contact", "slipping", "slip_m", "traction_pa", "pressure_pa")
    )
    x = (grid.x_mm()[None, :] - 600 * full) / (1e3 * a)
    r = np.hypot(x, grid.y_mm()[:, None] / (1e3 * a))
    # Nodes are 0.25 a apart.
    area = contact.sum() * (pitch_mm * 1e-3 / a) ** 2 / np.pi
    assert area == pytest.approx(1.0, abs=0.15)
    stuck = contact & ~slipping
    assert stuck[r < stick - 0.25].all() and not stuck[r > stick + 0.25].any()
    measured = np.sqrt(stuck.sum() / contact.sum() * area)
    assert measured == pytest.approx(stick, abs=0.125)
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


def test_chunks_and_chosen_environments_change_nothing():
    env = dragged()
    whole = [array.numpy().copy() for array in of(env).read(*CONTACT_SIGNALS)]
    signal = of(env, chunk_pixels=1)
    assert signal.chunk_envs == 1
    for array, expected in zip(signal.read(*CONTACT_SIGNALS), whole, strict=True):
        np.testing.assert_array_equal(array.numpy(), expected)
    for options in ({}, {"chunk_pixels": 1}):
        signal = of(env, **options)
        who = np.array([False, True])
        signal.update(env.state, who=who)
        for array, expected in zip(signal.read(*CONTACT_SIGNALS), whole, strict=True):
            np.testing.assert_array_equal(array.numpy(), expected[who])


def test_what_is_missing_is_said():
    env = dragged()
    signal = of(env)
    signal.update(env.state.positions)
    with pytest.raises(InputError, match=r"contact needs the state of the solver: update\(state\)"):
        signal.read("contact")
    bare = SignalTactile(env.mesh, GRID, env_count=len(AT_MM))
    bare.update(env.state)
    with pytest.raises(InputError, match="traction_pa needs the forces of a solver"):
        bare.read("traction_pa")
    with pytest.raises(InputError, match="there is no soft body 1; the scene has 1"):
        SignalTactile.from_solver(env.solver, GRID, gel=1)
    mesh = block_mesh((4, 4, 2), (12e-3, 12e-3, 4e-3))
    smooth = PressEnv(mesh, Material(1e5, 0.4), parse_indenter("sphere:4"), AT_MM[:1])
    smooth.move_to(0.1)
    signal = of(smooth)
    assert signal.contact.numpy().any()
    with pytest.raises(InputError, match="slip_m needs friction"):
        signal.read("slip_m")
    with pytest.raises(InputError, match="sliding needs friction"):
        _ = Outputs(smooth.solver).update(smooth.state).sliding


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
