# SPDX-License-Identifier: Apache-2.0
"""Settings of the solver: what is refused, and with which words."""

from __future__ import annotations

from typing import Any

import pytest

from taccel_lab.errors import InputError
from taccel_lab.solvers.config import SolverConfig

NAN = float("nan")


BAD = {
    "dhat_m": (0.0, -1e-5, 1.0, NAN),
    "relative_tolerance": (0.0, 2.0),
    "absolute_tolerance_n": (NAN, -1.0),
    "friction_eps_m": (0.0, float("inf")),
    "friction_speed_m_s": (0.0, NAN),
    "friction_step_share": (-0.1, 2.0, NAN),
    "kappa_pa": (0.0, NAN),
    "max_newton_iterations": (0,),
    "max_step_iterations": (0,),
    "max_cg_iterations": (-3,),
    "max_friction_lags": (0,),
    "max_line_search_cuts": (0,),
}


@pytest.mark.parametrize(("field", "value"), [(f, v) for f, values in BAD.items() for v in values])
def test_absurd_settings_are_refused_by_name(field: str, value: Any) -> None:
    with pytest.raises(InputError, match=field):
        SolverConfig(**{field: value})
