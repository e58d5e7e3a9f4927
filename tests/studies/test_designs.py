# SPDX-License-Identifier: Apache-2.0
"""One design: its files, its pictures before it is built, its task, and the page of studies."""

from __future__ import annotations

import json
import re
import tomllib
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from taccel_lab.cad.mesh.mesh_pad import MeshPad
from taccel_lab.cli.app import main
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region
from taccel_lab.geometry.block import block_mesh
from taccel_lab.sensors.profile_family import imported_gel
from taccel_lab.sensors.registry import sensor_family
from taccel_lab.studies.evaluate.batches import write_design_files
from taccel_lab.studies.evaluate.runner import default_kit, run_study
from taccel_lab.studies.evaluate.study_folder import StudyFolder
from taccel_lab.studies.metrics import METRICS
from taccel_lab.studies.metrics.design_point import DesignFigures, DesignPoint
from taccel_lab.studies.metrics.design_task import design_task
from taccel_lab.studies.metrics.evidence import Evidence
from taccel_lab.studies.report import preview as previews
from taccel_lab.studies.report import write_study_report
from taccel_lab.studies.report.describe import with_tables
from taccel_lab.studies.report.preview import preview_design, write_preview
from taccel_lab.studies.spec.study import make_study
from taccel_lab.studies.spec.study_file import StudyOutput, StudySpec, spec_of
from taccel_lab.tasks.catalogue import run_task
from taccel_lab.tasks.result import TaskResult, TaskTrial, success_interval
from taccel_lab.tasks.touch_insertion import TouchInsertionParameters
from tests.geometry.vtu_files import read_mesh_vtu
from tests.studies.coarse_presses import coarse
from tests.support.commands import refusal

# Files --------------------------------------------------------------------------------------------


def files_of(folder: StudyFolder, output: StudyOutput, **parameters: float) -> tuple[dict, dict]:
    point = DesignPoint("x", "gelsight_r15", parameters)
    return write_design_files(folder, DesignFigures(point), output, "as it is")


@pytest.mark.thorough
def test_pads_that_are_the_same_share_their_files(tmp_path: Path) -> None:
    def stamps() -> dict[Path, int]:
        return {path: path.stat().st_mtime_ns for path in tmp_path.glob("*/*")}

    folder, output = StudyFolder(tmp_path), StudyOutput(step=True)
    soft, causes = files_of(folder, output, young_modulus_mpa=0.1)
    written = stamps()
    assert set(soft) == {"mesh", "step"} and not causes and len(written) == 2
    assert files_of(folder, output, young_modulus_mpa=0.4)[0] == soft
    assert stamps() == written
    thick, _ = files_of(folder, output, thickness_mm=5.0)
    assert thick["mesh"] != soft["mesh"]
    default_mm = sensor_family("gelsight_r15").parameters().pad().thickness_mm
    for files, thickness_mm in ((soft, default_mm), (thick, 5)):
        z = read_mesh_vtu(tmp_path / files["mesh"]).nodes_m[:, 2]
        assert np.ptp(z) * 1e3 == pytest.approx(thickness_mm)
        assert (tmp_path / files["step"]).read_text().startswith("ISO-10303-21")


def test_only_what_is_asked_for_is_kept(tmp_path: Path) -> None:
    none = StudyOutput(meshes=False, pictures=False)
    assert files_of(StudyFolder(tmp_path), none) == ({}, {}) and not list(tmp_path.iterdir())


@pytest.mark.slow
@pytest.mark.rasterised
def test_a_real_study_from_file_to_report(tmp_path: Path) -> None:
    """Two moduli of one pad: one simulation, forces in proportion, pictures, a report."""
    metrics = ["stiffness_secant", "force_range", "pixel_size"]
    table = {
        "study": {"name": "Real", "sensor": "gelsight_r15", "metrics": metrics},
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


# Previews -----------------------------------------------------------------------------------------


@pytest.mark.thorough
def test_without_presses_there_are_pictures_and_photometry(tmp_path: Path) -> None:
    found = preview_design(sensor_family("flat_pad"), {"thickness_mm": 3.5}, presses=(), size_px=96)
    assert found.pressed is None and found.result.simulations == 0
    assert {metric.name for metric in found.metrics} >= {"visible_fraction", "pixel_size"}
    # Nobody asked for the 32 starts of a task.
    assert not any(metric.runs_task for metric in found.metrics)
    files = write_preview(found, tmp_path)
    assert set(files) == {"figures", "overview", "rest"}
    stored = json.loads(files["figures"].read_text())
    assert stored["parameters"]["thickness_mm"] == 3.5
    assert stored["photometry"]["light_rank"] == found.photometry.light_rank
    image = np.asarray(Image.open(files["rest"]))
    assert image.shape == found.rest.rgb.shape and max(image.shape) == 96
    assert 0 < image[found.rest.mask].mean() < 255


@pytest.mark.thorough
def test_a_press_shows_in_picture_and_figures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ball = coarse("sphere", depth_fraction=0.15, steps=3)
    monkeypatch.setattr(previews, "standard_presses", lambda names: [ball])
    out = tmp_path / "out"
    assert main(["preview", "gelsight", "--out", str(out), "--size-px", "96", "--json"]) == 0
    stored = json.loads((out / "preview.json").read_text())
    (curve,) = stored["presses"]["sphere"]
    assert np.diff([0.0, *(force[2] for force in curve["force_n"])]).min() > 0
    assert stored["figures"]["contact_area"]["unit"] == "mm2"
    rest, pressed = (
        np.asarray(Image.open(out / f"{name}.png")).astype(int) for name in ("rest", "pressed")
    )
    change = np.abs(pressed - rest).sum(axis=-1)
    rows, columns = np.indices(change.shape)
    middle = np.hypot(rows - rows.mean(), columns - columns.mean()) < 0.3 * change.shape[0]
    assert change[middle].mean() > 5 * change[~middle].mean()


def test_a_preview_of_a_few_pixels_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    told = refusal(capsys, "preview", "gelsight", "--out", tmp_path / "out", "--size-px", 4)
    assert "size of a preview must lie in [32, 4096] px" in told and not any(tmp_path.iterdir())


# In the task touch-insertion ----------------------------------------------------------------------


CHANGES = {"thickness_mm": 2.5, "young_modulus_mpa": 0.3, "marker_pitch_mm": 4.0}


def test_a_design_gives_the_task_its_gels_and_markers() -> None:
    mini = sensor_family("gelsight_mini")
    found, standard = (design_task(mini.parameters(c)).parameters for c in (CHANGES, {}))
    assert isinstance(found, TouchInsertionParameters)
    assert isinstance(standard, TouchInsertionParameters)
    assert found.gel.size_mm == pytest.approx((25.25, 20.75, 2.5))
    assert found.gel.young_modulus_pa == pytest.approx(3e5)
    assert found.markers.pitch_mm == (4.0, 1.9) and found.markers.columns == 5
    assert found.policy == standard.policy and found.start == standard.start
    with pytest.raises(InputError, match="this design has none"):
        design_task(sensor_family("gelsight").parameters())


@pytest.mark.thorough
def test_softer_gels_push_less_hard() -> None:
    """The policy feels the rim by the same way of the markers."""
    forces = []
    for modulus in (0.1, 1.0):
        mini = sensor_family("gelsight_mini").parameters({**CHANGES, "young_modulus_mpa": modulus})
        task = design_task(mini)
        task = replace(task, parameters=task.parameters.replace(steps=14))
        (trial,) = run_task(task, [0], "cpu").trials
        forces.append(trial.figures["jam_force_n"])
    assert 0.1 < forces[0] < forces[1] / 3


def test_metrics_are_the_rate_and_its_interval() -> None:
    evidence = Evidence(sensor_family("gelsight_mini").parameters(), {})
    trials = [TaskTrial(k, k < 12, "", 9, {}, {"jam_force_n": float(k)}) for k in range(16)]
    evidence.__dict__["insertion"] = TaskResult("touch-insertion", trials, 1.0, 16)
    evidence.__dict__["vitac"] = trials
    wanted = [100 * rate for rate in success_interval(12, 16)]
    for task in ("insertion", "vitac"):
        names = (f"{task}_{end}" for end in ("success", "low", "high"))
        assert [METRICS[name].compute(evidence) for name in names] == pytest.approx(wanted)
    assert METRICS["insertion_force"].compute(evidence) == 7.5


def test_the_task_has_the_shape_of_the_design() -> None:
    """A Mini is highest in its middle, and its rim lies 1.25 mm lower."""
    mini = sensor_family("gelsight_mini")
    task = design_task(mini.parameters())
    pad = mini.parameters().pad()
    face_mm = 1e3 * task.gel.nodes_m[task.gel.region_nodes(Region.CONTACT)]
    expected = pad.top_mm(face_mm[:, :2])
    inside = np.isfinite(expected)
    assert inside.sum() > 30
    np.testing.assert_allclose(face_mm[inside, 2], expected[inside], atol=1e-9)
    assert -1.3 < face_mm[:, 2].min() < -1.2 and face_mm[:, 2].max() > -0.05
    model = task.begin([0], "cpu").model
    nodes = model.bodies[model.body_id("left")].node_slice
    assert nodes.stop - nodes.start == task.gel.node_count


def test_an_imported_gel_keeps_its_mesh() -> None:
    mesh = block_mesh((4, 4, 2), (20e-3, 16e-3, 4e-3))
    pad = MeshPad(4.0, mesh=mesh)
    task = design_task(imported_gel(sensor_family("gelsight_mini"), pad).parameters())
    assert task.gel is mesh
    assert isinstance(task.parameters, TouchInsertionParameters)
    assert task.parameters.gel.size_mm == pytest.approx((20.0, 16.0, 4.0))


# The page docs/studies.md -------------------------------------------------------------------------


PAGE = Path(__file__).parents[2] / "docs" / "studies.md"


def test_the_page_of_studies() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert with_tables(text) == text, (
        "run: python -m taccel_lab.studies.report.describe docs/studies.md"
    )
    with pytest.raises(InputError, match="begin metrics"):
        with_tables("# empty\n")
    block, *_ = re.findall(r"```toml\n(.*?)```", text, flags=re.DOTALL)
    assert len(make_study(spec_of(tomllib.loads(block)), default_kit()).points()) == 32
    reference = text[text.index("| key |") : text.index("## Presses")]
    for table, field in StudySpec.model_fields.items():
        assert f"`{table}" in reference, table
        model = field.annotation
        if table in ("study", "sweep", "output", "run"):
            for key in model.model_fields:  # type: ignore[union-attr]
                assert f"`{table}.{key}`" in reference or f"`.{key}`" in reference, (table, key)
