# SPDX-License-Identifier: Apache-2.0
"""Settings of the solver: what is refused, and with which words."""

from __future__ import annotations

from typing import Any

import pytest

from taccel_lab.errors import InputError
from taccel_lab.solvers.config import SolverConfig

NAN = float("nan")


def test_the_defaults_are_allowed() -> None:
    config = SolverConfig()
    assert config.kappa_pa is None


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("dhat_m", 0.0),
        ("dhat_m", -1e-5),
        ("dhat_m", 1.0),
        ("dhat_m", NAN),
        ("relative_tolerance", 0.0),
        ("relative_tolerance", 2.0),
        ("absolute_tolerance_n", NAN),
        ("absolute_tolerance_n", -1.0),
        ("friction_eps_m", 0.0),
        ("friction_eps_m", float("inf")),
        ("friction_speed_m_s", 0.0),
        ("friction_speed_m_s", NAN),
        ("kappa_pa", 0.0),
        ("kappa_pa", NAN),
        ("max_newton_iterations", 0),
        ("max_cg_iterations", -3),
        ("max_friction_lags", 0),
        ("max_line_search_cuts", 0),
    ],
)
def test_absurd_settings_are_refused_by_name(field: str, value: Any) -> None:
    with pytest.raises(InputError, match=field):
        SolverConfig(**{field: value})
