# SPDX-License-Identifier: Apache-2.0
"""95 % intervals of fits without profiles hold the truth as often as they say: drawn records."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

from taccel_lab.calibration.capture.schema import ToolEntry
from taccel_lab.calibration.material.force_table import ForceTable, TableError
from taccel_lab.calibration.material.gel import Gel, Tool
from taccel_lab.calibration.material.indentation import (
    USUAL_COUNT,
    USUAL_NOISE,
    IndentationFit,
    fit_indentation,
)
from tests.calibration.material.made_up import layer_table, points

MODULUS_PA, POISSON = 2.4e5, 0.47
TOUCH_SIGMA_MM = 0.03
LARGEST_NOISE = 0.1
"""Beyond it a fit is no longer nearly linear."""
DRAWS = 300
ALLOWED = tuple(binom.interval(0.999, DRAWS, 0.95))
"""How many of the draws an interval of 95 % may hold the truth in."""


@pytest.fixture(scope="module")
def tool(gel: Gel) -> Tool:
    return gel.tool(ToolEntry(kind="sphere", radius_mm=7.5))


@pytest.fixture(scope="module")
def exact() -> ForceTable:
    """A table that is taken to have no error, so that noise alone makes the intervals."""
    table = layer_table("sphere", 7.5)
    return replace(table, error=TableError(0.0, np.zeros_like(table.error.mesh)))


def fitted(
    rng: np.random.Generator,
    tool: Tool,
    table: ForceTable,
    *,
    count: int,
    noise: float,
    stated: bool,
    scale: float = 1.0,
) -> tuple[IndentationFit, float]:
    """A fit without profiles to a drawn record, and how late its tool touched [mm].

    Args:
        count: Points of the record.
        noise: Standard deviation of a reading as a part of its force.
        stated: Whether the record states it.
        scale: Of the true forces over those of the table.
    """
    depth = np.linspace(0.3, 1.3, count)
    late_mm = float(rng.normal(0, TOUCH_SIGMA_MM))
    force = scale * table.force_n(depth - late_mm, MODULUS_PA, POISSON)
    read = force * (1 + noise * rng.normal(size=count))
    sigma = noise * force if stated else None
    fit = fit_indentation(
        [points(tool, depth, read, sigma)], [table], start_pa=1e5, poisson_ratio=POISSON,
        free_nu=False, touch_sigma_mm=TOUCH_SIGMA_MM, profiled=(),
    )  # fmt: skip
    assert not fit.solution.profiles
    return fit, late_mm


@pytest.mark.parametrize(
    ("count", "stated"),
    [
        pytest.param(12, True, marks=pytest.mark.slow),
        (4, True),
        pytest.param(12, False, marks=pytest.mark.slow),
        (4, False),
    ],
)
def test_noise_alone(tool: Tool, exact: ForceTable, count: int, stated: bool) -> None:
    """Of a stated noise, and of one that a few points have to tell: usual, but for chance."""
    rng = np.random.default_rng(count)
    held = np.zeros(2, dtype=int)
    usual = USUAL_NOISE["proportional"]
    for _ in range(DRAWS):
        drawn = min(usual * np.sqrt(USUAL_COUNT / rng.chisquare(USUAL_COUNT)), LARGEST_NOISE)
        noise = usual if stated else drawn
        fit, late_mm = fitted(rng, tool, exact, count=count, noise=noise, stated=stated)
        low, high = fit.young_interval_pa
        held[0] += low <= MODULUS_PA <= high
        low, high = fit.touch_interval_mm(0)
        held[1] += low <= late_mm <= high
    # The touch point has a prior that is right: its interval holds it a little more often.
    assert ALLOWED[0] <= held[0] <= ALLOWED[1], held
    assert ALLOWED[0] <= held[1], held


def test_an_error_of_the_table_widens_the_interval(tool: Tool) -> None:
    """Of a table that is off by one factor, drawn from the error that it states."""
    table = layer_table("sphere", 7.5)
    table = replace(table, error=TableError(0.03, np.zeros_like(table.error.mesh)))
    rng = np.random.default_rng(7)
    held = 0
    for _ in range(DRAWS):
        scale = float(np.exp(0.03 * rng.normal()))
        fit, _ = fitted(rng, tool, table, count=12, noise=0.01, stated=True, scale=scale)
        low, high = fit.young_interval_pa
        held += low <= MODULUS_PA <= high
    assert ALLOWED[0] <= held <= ALLOWED[1]


@pytest.mark.parametrize("stated", [True, False])
def test_it_is_about_as_wide_as_the_profile(tool: Tool, exact: ForceTable, stated: bool) -> None:
    """Of a fit that is nearly linear the likelihood falls as that of a normal, or t, does."""
    rng = np.random.default_rng(11)
    for count in (5, 12):
        bare, _ = fitted(rng, tool, exact, count=count, noise=0.01, stated=stated)
        likelihood = bare.likelihood
        whole = replace(bare, solution=likelihood.solve(("ln_e", "touch_0")))
        assert np.log(bare.young_interval_pa) == pytest.approx(
            np.log(whole.young_interval_pa), abs=0.1 * np.ptp(np.log(whole.young_interval_pa))
        )
        width = np.ptp(whole.touch_interval_mm(0))
        assert bare.touch_interval_mm(0) == pytest.approx(
            whole.touch_interval_mm(0), abs=0.1 * width
        )
