# SPDX-License-Identifier: Apache-2.0
"""Files of designs: meshes and STEP files by pad, pictures of real presses."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from taccel_lab.sensors.registry import sensor_family
from taccel_lab.studies.design_files import write_design_files
from taccel_lab.studies.design_point import DesignPoint, DesignResult
from taccel_lab.studies.report import write_study_report
from taccel_lab.studies.runner import run_study
from taccel_lab.studies.spec import Output, spec_of
from taccel_lab.studies.study import default_kit, make_study
from taccel_lab.studies.study_folder import StudyFolder
from tests.geometry.vtu_files import read_mesh_vtu


def files_of(folder: StudyFolder, output: Output, **parameters: float) -> tuple[dict, dict]:
    point = DesignPoint("x", "gelsight_r15", parameters)
    return write_design_files(folder, DesignResult(point), output, "as it is")


def test_pads_that_are_the_same_share_their_files(tmp_path: Path) -> None:
    folder, output = StudyFolder(tmp_path), Output(step=True)
    soft, causes = files_of(folder, output, young_modulus_mpa=0.1)
    assert set(soft) == {"mesh", "step"} and not causes
    written = {path: path.stat().st_mtime_ns for path in tmp_path.glob("*/*")}
    assert len(written) == 2
    assert files_of(folder, output, young_modulus_mpa=0.4)[0] == soft
    assert {path: path.stat().st_mtime_ns for path in tmp_path.glob("*/*")} == written
    thick, _ = files_of(folder, output, thickness_mm=5.0)
    assert thick["mesh"] != soft["mesh"]
    for files, thickness in (
        (soft, sensor_family("gelsight_r15").parameters().pad().thickness_mm),
        (thick, 5),
    ):
        z = read_mesh_vtu(tmp_path / files["mesh"]).nodes_m[:, 2]
        assert np.ptp(z) * 1e3 == pytest.approx(thickness)
        assert (tmp_path / files["step"]).read_text().startswith("ISO-10303-21")


def test_only_what_is_asked_for_is_kept(tmp_path: Path) -> None:
    files, causes = files_of(StudyFolder(tmp_path), Output(meshes=False, pictures=False))
    assert not files and not causes and not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_real_study_from_file_to_report(tmp_path: Path) -> None:
    """Two moduli of one pad: one simulation, forces in proportion, pictures, a report."""
    table = {
        "study": {
            "name": "Real",
            "sensor": "gelsight_r15",
            "metrics": ["stiffness_secant", "force_range", "pixel_size"],
        },
        "parameters": {"young_modulus_mpa": {"values": [0.2, 0.4]}},
        "sweep": {"kind": "grid"},
    }
    planned = make_study(spec_of(table), default_kit())
    outcome = run_study(planned, tmp_path, processes=1)
    soft, hard = outcome.rows
    assert soft.status == hard.status == "done", (soft.cause, hard.cause)
    assert sorted((soft.simulations, hard.simulations)) == [0, 1]
    for press, curves in soft.curves.items():
        forces = [np.array(row.curves[press][0]["force_n"]) for row in (soft, hard)]
        np.testing.assert_allclose(forces[1], 2 * forces[0], rtol=1e-12, atol=1e-12)
        assert curves[0]["cause"] == ""
    assert hard.figures["force_range"] == pytest.approx(2 * soft.figures["force_range"])  # type: ignore[operator]
    assert soft.files["mesh"] == hard.files["mesh"]
    for row in outcome.rows:
        picture = cv2.imread(str(tmp_path / row.files["picture"]))
        assert picture is not None and picture.std() > 5
        assert (outcome.folder.design(row.id) / "press_sphere.npz").is_file()
    assert write_study_report(outcome)["verdict"]["good"]
    assert run_study(planned, tmp_path, processes=1).new == 0
