# SPDX-License-Identifier: Apache-2.0
"""The material of a GelSight Mini gel from measured press forces (FEATS, MIT licence).

Three points of a ball of 7.5 mm radius: one modulus explains them within 3 %; they do not tell
Poisson's ratio, and the calibration has to say so.
"""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest

from calibration.capture import load_capture_folder
from calibration.material import MaterialOptions, calibrate_material
from calibration.material.setup import QUICK
from calibration.result import Verdict, judge
from sensors.profile import catalogue_profile

DATA = Path(os.environ.get("TACCEL_LAB_DATA", Path(__file__).parents[3] / "shared" / "data"))
MEASURED = DATA / "gsmini_feats_calib" / "force_indentation.json"


@pytest.mark.skipif(not MEASURED.is_file(), reason=f"measured forces not found at {MEASURED}")
def test_one_modulus_within_three_per_cent(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TACCEL_LAB_CACHE", str(tmp_path / "cache"))
    data = json.loads(MEASURED.read_text())
    rows = zip(data["indentation_mm"], data["normal_force_N"], strict=True)
    (tmp_path / "press.csv").write_text(
        "depth_mm,force_n\n" + "".join(f"{depth},{force}\n" for depth, force in rows)
    )
    (tmp_path / "captures.toml").write_text(
        'schema_version = 2\nsensor = "gelsight_mini"\nsource = "FEATS"\n[[records]]\n'
        'file = "press.csv"\nkind = "indentation"\ntool = { kind = "sphere", radius_mm = 7.5 }\n'
    )
    base = catalogue_profile("gelsight_mini")
    found = calibrate_material(
        load_capture_folder(tmp_path), base, MaterialOptions(effort=QUICK, fixed={"friction": 0.0})
    )
    assert found.indentation is not None and found.young_modulus_pa is not None
    assert np.abs(found.indentation.relative_residuals(0)).max() < 0.03
    low, high = found.young_modulus_pa.interval95
    # Gent's formula for the vendor's 55 Shore 00 gives 0.41 to 0.47 MPa; for nu = 0.46 the layer is
    # a little softer than for 0.48, so the modulus is a little higher.
    assert 4.1e5 < low < 5.0e5 < high < 5.6e5
    assert found.poisson_ratio is None
    assert {"nu_untold", "young_given_nu"} <= {remark.code for remark in found.remarks}
    assert judge(found.remarks) is Verdict.GOOD
    block = found.apply_to(base).material
    assert block.young_modulus_pa == found.young_modulus_pa.value
    assert block.poisson_ratio == base.material.poisson_ratio
    assert block.provenance.valid_region["depth_mm"] == (0.5, 1.5)
