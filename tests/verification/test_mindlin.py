# SPDX-License-Identifier: Apache-2.0
"""A rigid ball pressed into a half-space and then moved along it: partial slip with friction.

For a normal force F on a contact of radius a and a tangential force Q below mu F the ball moves by

    dx = 3 mu F (2 - nu) / (16 a G) [1 - (1 - Q / (mu F))^(2/3)]

and the nodes within c = a (1 - Q / (mu F))^(1/3) stick [Cattaneo 1938; Mindlin 1949; Johnson 1985,
Contact Mechanics, section 7.2; for two equal bodies each moves by this much].

The theory takes normal and tangential displacements for independent, which between a rigid and an
elastic body holds at nu = 0.5 only; the factor of the coupling, (1 - 2 nu) / (2 (1 - nu)), is 2 %
at the 0.49 used here (quadratic tets do not lock). The normal force is applied without friction, as
in the theory, by a first solver whose friction sets in at sliding of a centimetre only.

Sliding, averaged around the axis: with the tractions mu p(a) - (c / a) mu p(c) of [Johnson] and
the displacements that an elliptic pressure makes inside and outside of its circle (section 3.4),

    s(r) / dx_0 = r^2 / (2 a^2) - c^2 / a^2 + [(2 c^2 - r^2) asin(c / r) + r c sqrt(1 - c^2 / r^2)]
                  / (pi a^2)   for r > c,   dx_0 = dx at Q = mu F;

what is left out goes with cos(2 phi) around the axis.

On the way back from dx* and Q* every node sticks again, and slips anew from the rim inwards against
twice the limit [Mindlin, Deresiewicz 1953]: Q* - Q(dx) = 2 Q_first((dx* - dx) / 2), with Q_first
the curve of the first loading above. The loop between dx* and -dx* takes

    W = 8 int_0^dx* Q_first ddx - 4 Q* dx*.
"""

from __future__ import annotations

from functools import lru_cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from taccel_lab.scene import Ball
from taccel_lab.solvers import SolverConfig, SolverIPC
from tests.verification.half_space import DOMAIN_OVER_RADIUS, GROWTH, HalfSpace, half_space_mesh

BALL, DEPTH, YOUNG, POISSON = 1e-2, 2.5e-5, 1e5, 0.49
DHAT, EPS = 0.01 * DEPTH, 2e-8
SHEAR = YOUNG / (2 * (1 + POISSON))
RADIUS = float(np.sqrt(BALL * (DEPTH + DHAT)))
"""Hertz's, for contact that begins at a gap of dhat [m]."""
MU = 0.3


def first_loading(shift: float) -> float:
    """Q / (mu F) by Mindlin at a dx over that at full slip."""
    return 1 - max(0.0, 1 - shift) ** 1.5


def sliding(radii: np.ndarray, stick: float) -> np.ndarray:
    """Mean sliding around the axis over dx at full slip; ``radii`` and ``stick`` over a."""
    r = np.maximum(radii, stick)
    q = stick / r
    outside = (2 * stick**2 - r**2) * np.arcsin(q) + r * stick * np.sqrt(1 - q**2)
    return r**2 / 2 - stick**2 + outside / np.pi


def pressed_block(cells: int, eps_m: float = EPS) -> tuple[HalfSpace, float, float]:
    """A ball pressed in without friction, then with it; the load [N], dx at full slip [m]."""
    settings: dict[str, Any] = {
        "dhat_m": DHAT,
        "relative_tolerance": 1e-5,
        "absolute_tolerance_n": 1e-12,
    }
    block = HalfSpace(
        half_space_mesh(RADIUS, cells, DOMAIN_OVER_RADIUS * RADIUS, GROWTH),
        Ball(BALL),
        young_pa=YOUNG,
        poisson=POISSON,
        friction=MU,
        start_m=BALL + 2 * DHAT,
        friction_eps_m=1e-2,
        friction_step_share=0.0,
        **settings,
    )
    block.move(0.0, BALL - DEPTH)
    load = -float(block.normal_n[:, 2].sum())
    block.solver = SolverIPC(block.model, SolverConfig(friction_eps_m=eps_m, **settings))
    return block, load, 3 * MU * load * (2 - POISSON) / (16 * RADIUS * SHEAR)


@lru_cache
def slid(cells: int, *shifts: float) -> list[SimpleNamespace]:
    """The ball pressed in, then at each of ``shifts``, parts of dx at full slip: Q and the forces
    beside it over mu F, the normal force lost, and radii, lags, friction and load of the nodes."""
    block, load, full = pressed_block(cells)
    before, points = block.positions_m, []
    for shift in shifts:
        dx = shift * full
        block.move(dx, BALL - DEPTH)
        normal, friction, x = block.normal_n, block.friction_n, block.positions_m
        size = np.linalg.norm(normal, axis=1)
        # Corners of quadratic faces carry nearly nothing, and slide with what is around them.
        loaded = size > 0.1 * size.max()
        ratio, across, _ = friction.sum(axis=0) / (MU * load)
        points.append(
            SimpleNamespace(
                shift=shift,
                ratio=ratio,
                across=across,
                lost=-normal[:, 2].sum() / load - 1,
                radii=np.hypot(x[loaded, 0] - dx, x[loaded, 1]) / RADIUS,
                slip=(dx - (x - before)[loaded, 0]) / full,
                friction=np.linalg.norm(friction[loaded], axis=1) / (MU * size[loaded]),
                weight=size[loaded] / load,
            )
        )
    return points


def check(point: SimpleNamespace, tolerance: float, spacing: float) -> None:
    assert point.ratio == pytest.approx(first_loading(point.shift), rel=tolerance)
    assert abs(point.lost) < 2e-3, "no coupling with the normal force"
    assert abs(point.across) < 2e-3
    # c / a by Mindlin at this Q, and that whose sliding is nearest to that of the nodes.
    stick = max(0.0, 1 - point.ratio) ** (1 / 3)
    tried = np.linspace(0.01, 1.0, 397)
    loss = [(point.weight * (point.slip - sliding(point.radii, c)) ** 2).sum() for c in tried]
    assert tried[np.argmin(loss)] == pytest.approx(stick, abs=0.5 * spacing)
    # Nodes within the radius stick, nodes beyond it slide at the friction limit.
    inner, outer = point.radii < stick - spacing, point.radii > stick + spacing
    assert (point.slip[inner] < 0.01).all() and not (point.slip[outer] < 0.01).any()
    assert point.friction[inner].max(initial=0) < 0.99 < point.friction[outer].min(initial=1)


@pytest.mark.thorough
def test_partial_slip_and_full_slip() -> None:
    """Two elements along the contact radius, with nodes 0.25 a apart."""
    partial, full = slid(2, 0.6, 1.3)
    check(partial, tolerance=0.05, spacing=0.25)
    assert partial.friction.max() < 1.01, "nowhere above the limit"
    assert full.ratio == pytest.approx(1.0, abs=2e-3)
    assert full.slip.min() > 0.2


@pytest.mark.slow
def test_tangential_loading_curve() -> None:
    """Four elements along the contact radius, with nodes 0.125 a apart."""
    points = slid(4, 0.15, 0.3, 0.5, 0.7, 0.9, 1.1)
    for point in points[:-1]:
        check(point, tolerance=0.03, spacing=0.125)
    assert points[-1].ratio == pytest.approx(1.0, abs=2e-3)
    assert (np.diff([p.ratio for p in points]) > 0).all()


@pytest.mark.slow
def test_the_way_there_does_not_matter() -> None:
    """Coulomb friction forgets how a growing load was cut into steps, but for eps a step."""
    at_once, in_parts = slid(2, 0.6)[-1], slid(2, 0.2, 0.4, 0.6)[-1]
    assert in_parts.ratio == pytest.approx(at_once.ratio, rel=3e-3)


def ways(first: np.ndarray) -> np.ndarray:
    """Ratios there, back and there again that follow from those of the first way."""
    return np.concatenate([first, first[-1] - 2 * first, 2 * first - first[-1]])


@lru_cache
def looped(cells: int, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """dx over that at full slip, to and fro within 0.8, and Q over mu F; friction is static below
    1 um, a tenth of dx at full slip, at most."""
    block, load, full = pressed_block(cells, SolverConfig.friction_eps_m)
    part, ratios = np.arange(1, steps + 1) / steps, []
    shifts = 0.8 * np.concatenate([part, 1 - 2 * part, 2 * part - 1])
    for shift in shifts:
        block.move(shift * full, BALL - DEPTH)
        ratios.append(block.friction_n[:, 0].sum() / (MU * load))
    return shifts, np.array(ratios)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("cells", "force", "loss"),
    [(2, 0.055, 0.26), pytest.param(3, 0.026, 0.13, marks=pytest.mark.slow)],
)
def test_loop_of_partial_slip(cells: int, force: float, loss: float) -> None:
    """Within ``force`` of mu F of the curve, and ``loss`` of the small difference that it takes."""
    steps = 8
    shifts, ratios = looped(cells, steps)
    first = ratios[:steps]
    expected = ways(np.array([first_loading(shift) for shift in shifts[:steps]]))
    assert np.abs(ratios - expected).max() < force
    taken, wanted = (np.trapezoid(r[steps - 1 :], shifts[steps - 1 :]) for r in (ratios, expected))
    assert taken == pytest.approx(wanted, rel=loss)
    # Closed, and what follows from its first loading, whatever the mesh makes of that.
    assert ratios[-1] == pytest.approx(first[-1], abs=2e-3)
    assert np.abs(ratios - ways(first)).max() < 0.008


@pytest.mark.thorough
def test_loops_do_not_depend_on_the_number_of_steps() -> None:
    """What sticks creeps a part of the way, not of each step."""
    assert np.abs(looped(2, 8)[1][3::4] - looped(2, 2)[1]).max() < 0.005
