# SPDX-License-Identifier: Apache-2.0
"""Numbers that no generator takes are refused where they are given, not minutes later."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.calibration.color.fit_options import ColorFitOptions
from taccel_lab.calibration.depth.options import DepthOptions
from taccel_lab.calibration.normals.network_fit import InverseFitOptions
from taccel_lab.cli.app import main
from taccel_lab.errors import InputError
from taccel_lab.files.seed import MOST_SEED, require_seed
from taccel_lab.learning.force.options import ForceOptions
from taccel_lab.profile import save_profile
from tests.support.synthetic_presses import GRID, flat_profile, synthetic_captures, write_captures


@pytest.mark.parametrize("seed", [-1, 10**20])
@pytest.mark.parametrize(
    "options", [ColorFitOptions, InverseFitOptions, DepthOptions, ForceOptions]
)
def test_options_refuse_it(options: Callable[..., object], seed: int) -> None:
    with pytest.raises(InputError, match=rf"seed must lie in 0\.\.{MOST_SEED}, got {seed}"):
        options(seed=seed)


def test_the_largest_seed_is_taken() -> None:
    torch = pytest.importorskip("torch")
    require_seed(MOST_SEED)
    np.random.default_rng(MOST_SEED)
    torch.Generator().manual_seed(MOST_SEED)


def test_practice_has_an_end() -> None:
    with pytest.raises(InputError, match=r"practice must lie in 0\.\.10000, got -1"):
        InverseFitOptions(practice=-1)


def test_live_needs_something_to_read_before_it_asks_for_the_camera(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save_profile(flat_profile(GRID), tmp_path / "profile")
    write_captures(tmp_path / "captures", synthetic_captures(count=3)[0])
    words = ["live", str(tmp_path / "profile"), "--camera", str(tmp_path / "captures")]
    assert main(words) == 2
    told = "".join(capsys.readouterr()).replace("\n", " ")
    assert "no normals, depth_response, markers or force block" in told
    assert "Touch nothing" not in told and "http" not in told
