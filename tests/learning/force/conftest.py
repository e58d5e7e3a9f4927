# SPDX-License-Identifier: Apache-2.0
"""Made-up touches, and a force model trained on them, for the tests of this folder."""

from __future__ import annotations

from pathlib import Path

import pytest

from taccel_lab.learning.force.fit import calibrate_force
from taccel_lab.learning.force.options import ForceOptions
from taccel_lab.learning.force.result import ForceCalibration
from tests.learning.force.small_touches import planned, write_touches
from tests.support.small_data_sets import saved_profile

QUICK = ForceOptions(steps=250, batch=32, stiffness=0.1, light=0.3, markers="off")


@pytest.fixture(scope="session")
def sensor(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return saved_profile(tmp_path_factory.mktemp("force") / "pad")


@pytest.fixture(scope="session")
def touches(sensor: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data set; not to be changed."""
    return write_touches(planned(sensor), tmp_path_factory.mktemp("touches") / "data")


@pytest.fixture(scope="session")
def trained(touches: Path) -> ForceCalibration:
    return calibrate_force(touches, options=QUICK)
