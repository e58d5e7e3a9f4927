# SPDX-License-Identifier: Apache-2.0
"""A peg between two gels on moving mounts: carried by friction, over the rim, into a hole."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.benchmarks.scenes.peg import peg_config
from taccel_lab.exporters.published_meshes import mesh_folder
from taccel_lab.outputs import Outputs
from taccel_lab.tasks.peg_scene import (
    DT_S,
    GRAVITY,
    PEG_MASS_KG,
    PUBLISHED,
    PegParts,
    PegPath,
    generated_parts,
    peg_scene,
    published_parts,
    targets,
)
from tests.support.scene_steps import Watched
from tests.support.variants import variants

RIM_M = 0.02
CENTRED = PegPath(
    (0.0, 0.0, 0.021),
    (0.0, 0.02, 0.06, 0.5),
    np.array([(0.0171, 0, 0.071), (0.0165, 0, 0.071), (0.0165, 0, 0.071), (0.0165, 0, 0.055)]),
    first=1,
)
"""A quick insertion that meets nothing: gripped in the first step, then straight down."""


def parts_of(source: str) -> PegParts:
    if source == "generated":
        return generated_parts()
    if not (mesh_folder() / "peg").is_dir():
        pytest.skip(f"the published meshes are not at {mesh_folder()}")
    return published_parts(mesh_folder())


class Insertion(Watched):
    """The scene, stepped: each step converges, nothing intersects, the peg obeys Newton's law."""

    def __init__(
        self, parts: PegParts, path: PegPath, hole_is_affine: bool = False, **config: float
    ) -> None:
        self.scene, self.path = peg_scene(parts, path, hole_is_affine=hole_is_affine), path
        super().__init__(self.scene, targets(self.scene, 0, path), config=peg_config(**config))
        self.outputs = Outputs(self.solver)
        self.peg = self.model.body_id("peg")
        self.taken = self.newton = 0

    def run(self, steps: int) -> None:
        center = self.model.affine.first_control
        for _ in range(steps):
            poses = targets(self.scene, self.path.first + self.taken, self.path)
            self.taken += 1
            before = self.state.velocities.numpy()[0, center].copy()
            report = self.step(poses)
            self.newton += report.newton_iterations[0]
            self.outputs.update(self.state)
            total = self.on_peg("contact") + self.on_peg("friction")
            gained = (self.state.velocities.numpy()[0, center] - before) / DT_S
            np.testing.assert_allclose(
                total + PEG_MASS_KG * np.array(GRAVITY),
                PEG_MASS_KG * gained,
                atol=2 * max(report.residual_n[0], 1e-6),
            )

    def on_peg(self, kind: str, other: str | None = None) -> np.ndarray:
        pairs = getattr(self.outputs, f"{kind}_wrenches")().wrenches.numpy()[0, self.peg, :, :3]
        return pairs.sum(axis=0) if other is None else pairs[self.model.body_id(other)]

    @property
    def lowest(self) -> float:
        return float(self.x(self.peg)[:, 2].min())


@pytest.mark.thorough
@pytest.mark.parametrize("hole_is_affine", variants([True], [False, True]))
def test_friction_carries_the_peg_into_the_hole(hole_is_affine: bool) -> None:
    run = Insertion(generated_parts(), CENTRED, hole_is_affine, friction_speed_m_s=2e-6 / DT_S)
    run.run(3)
    gripped = run.lowest
    assert PUBLISHED.peg_m[2] - 5e-4 < gripped < PUBLISHED.peg_m[2]
    run.run(22)
    # With the gels, by 16 mm; it creeps by less than a micrometre a step.
    assert gripped - run.lowest == pytest.approx(16e-3, abs=2e-5)
    assert run.lowest < RIM_M - 0.01
    weight = PEG_MASS_KG * -GRAVITY[2]
    grips = [
        run.on_peg("friction", side) + run.on_peg("contact", side) for side in ("left", "right")
    ]
    assert sum(grips)[2] == pytest.approx(weight, rel=2e-2)
    assert run.on_peg("friction")[2] > 0.5 * weight
    # Each gel is squeezed by half a millimetre, and they balance.
    assert grips[0][0] == pytest.approx(-grips[1][0], rel=1e-2)
    assert grips[0][0] > 3
    np.testing.assert_array_equal(run.on_peg("contact", "hole"), 0)
    if hole_is_affine:
        place = run.x("hole")[0]
        np.testing.assert_allclose(place, run.scene.affine_bodies[1].shape.vertices_m[0], atol=1e-8)


@pytest.mark.parametrize("source", variants(["published"], ["generated", "published"]))
def test_the_first_steps_of_the_published_insertion(source: str) -> None:
    run = Insertion(parts_of(source), PUBLISHED)
    run.run(12)
    # It has fallen onto the rim, on one side; the gels press it down and drag it along.
    assert run.lowest < RIM_M - 1e-3
    assert run.on_peg("contact", "hole")[2] > 2 * PEG_MASS_KG * -GRAVITY[2]
    assert run.on_peg("contact", "left")[0] > 3
    assert run.newton < 400


@pytest.mark.slow
@pytest.mark.parametrize("source", ["generated", "published"])
def test_the_whole_published_insertion(source: str) -> None:
    run = Insertion(parts_of(source), PUBLISHED)
    run.run(200)
    assert run.lowest < RIM_M - 8e-3
    assert run.newton < 5000
