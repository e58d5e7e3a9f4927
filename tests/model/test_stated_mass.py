# SPDX-License-Identifier: Apache-2.0
"""Bodies whose mass is stated: what a model has of them, and how it changes."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.scene import AffineBody, Scene, StatedMass, TimeStepping, box_mesh


def test_a_stated_mass_is_set_as_a_mass() -> None:
    stated = StatedMass(0.01, np.array([1e-3, 0, 0]), 1e-7 * np.eye(3))
    cube = AffineBody(box_mesh((4e-3, 4e-3, 4e-3)), name="cube", stated_mass=stated)
    model = Scene(affine_bodies=cube, env_count=2, time=TimeStepping(quasi_static=False)).finalize()
    first = model.affine.first_control
    np.testing.assert_allclose(model.masses.numpy()[:, first], 0.01)
    # Moments of the control vectors: tr(I) / 2 - I.
    lengths = model.affine.lengths.numpy()[0]
    moments = model.masses.numpy()[0, first + 1 : first + 4] * lengths**2
    np.testing.assert_allclose(moments, 5e-8)
    model.set_body("cube", mass_kg=[0.02, 0.03])
    np.testing.assert_allclose(model.masses.numpy()[:, first], [0.02, 0.03])
    with pytest.raises(InputError, match="'cube' has a stated mass, not a density: set mass_kg"):
        model.set_body("cube", density_kg_m3=500.0)
