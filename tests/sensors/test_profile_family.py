# SPDX-License-Identifier: Apache-2.0
"""The folder of a profile is a sensor wherever a name of the catalogue is one."""

from __future__ import annotations

import json
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.cad.mesh.mesh_pad import MeshPad, SurfacePad
from taccel_lab.calibration.base_profile import base_profile
from taccel_lab.calibration.capture.load import load_capture_folder
from taccel_lab.calibration.capture.sensor_facts import sensor_facts
from taccel_lab.cli.app import main
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region
from taccel_lab.profile import Provenance, SensorProfile, load_profile, save_profile
from taccel_lab.scene import Element, Material
from taccel_lab.sensors import SensorFamily, sensor_families
from taccel_lab.sensors.profile import catalogue_profile, load_sensor
from taccel_lab.sensors.registry import (
    known_sensor,
    profile_folder,
    profile_parameters,
    profile_sensor,
    sensor_family,
)
from taccel_lab.studies.evaluate.evaluate import evaluate_designs
from taccel_lab.studies.evaluate.runner import default_kit
from taccel_lab.studies.metrics import METRICS
from taccel_lab.studies.presses.press_batch import REFERENCE_PA, press_jobs, simulate
from taccel_lab.studies.spec.study import make_study
from taccel_lab.studies.spec.study_file import load_spec
from tests.sensors.imported_profiles import SIZE, imported
from tests.studies.coarse_presses import coarse
from tests.support.finite_element_press import SURFACE_PHYSICS
from tests.support.synthetic_presses import synthetic_captures, write_captures
from tests.support.variants import variants

MINE = {"young_modulus_mpa": 0.2, "width_px": 96, "height_px": 72}
OTHER_SIZE = {**SIZE, "crown_radius_mm": 30.0}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """As import-step leaves it: an output with the profile in it."""
    out = tmp_path_factory.mktemp("sensors") / "out"
    out.mkdir()
    save_profile(imported(**MINE), out / "profile")
    return out


def family_of(profile: SensorProfile, folder: Path) -> SensorFamily:
    """The profile's folder as a sensor."""
    save_profile(profile, folder / "saved")
    return sensor_family(str(folder / "saved"))


def test_folder_and_file_are_one_sensor(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    inside = folder / "profile"
    for name in (folder, inside, inside / "profile.toml"):
        assert sensor_family(str(name)).name == str(inside)
        assert load_sensor(str(name)).sensor.name == "mine"
    monkeypatch.chdir(folder.parent)
    (folder.parent / "digit").symlink_to(folder)
    assert sensor_family("digit").name == "digit" and profile_folder("digit") is None
    assert sensor_family("./digit").label == "mine"
    assert known_sensor("no_such") is None
    with pytest.raises(InputError, match="folder of a profile"):
        sensor_family("no_such")


@pytest.mark.parametrize("ratio", variants([0.48], [0.46, 0.48, None]))
def test_a_profile_of_a_hardness_keeps_its_ratio(tmp_path: Path, ratio: float | None) -> None:
    values = {"shore_00": 40.0} | ({} if ratio is None else {"poisson_ratio": ratio})
    profile = catalogue_profile("digit", values)
    material = family_of(profile, tmp_path).parameters().material()
    assert material.poisson_ratio == profile.material.poisson_ratio == (ratio or 0.499)
    assert material.young_interval_pa is not None


def test_a_branch_is_a_parameter_and_a_measured_one_stays(tmp_path: Path) -> None:
    profile = catalogue_profile("digit", {"maxwell_modulus": 0.3, "maxwell_time_s": 2.0})
    (branch,) = profile.material.branches
    assert (branch.relative_modulus, branch.time_s) == (0.3, 2.0)
    assert not catalogue_profile("digit").material.branches
    bench = Provenance(kind="measured", method="relaxometer", source="bench")
    measured = profile.material.replace(provenance=bench, branches=(branch.replace(time_s=5.0),))
    found = family_of(profile.with_block(measured), tmp_path).parameters().material()
    assert found.branches == ((0.3, 5.0),)
    two = measured.replace(branches=(branch, branch.replace(time_s=20.0)))
    with pytest.raises(InputError, match="2 branches"):
        family_of(profile.with_block(two), tmp_path)


def test_camera_and_material_can_be_set_and_the_gel_stays(folder: Path) -> None:
    family = sensor_family(str(folder))
    defaults = family.parameters()
    assert defaults.material().young_modulus_pa == pytest.approx(2e5)
    assert defaults.grid().width_px == 96 and defaults.housing() is None
    assert len(defaults.layer_materials()) == 1
    pad = defaults.pad()
    assert pad.thickness_mm == pytest.approx(4.0, abs=0.05)
    assert pad.top_mm(np.zeros(2)) == pytest.approx(0.0, abs=1e-3)
    softer = family.parameters({"shore_00": 30, "camera_distance_mm": 30})
    assert softer.material().young_modulus_pa != pytest.approx(2e5)
    assert (defaults.material().poisson_ratio, softer.material().poisson_ratio) == (0.46, 0.499)
    assert repr(softer.pad()) == repr(pad)
    with pytest.raises(InputError, match="length_x_mm cannot be set: the file"):
        family.parameters({"length_x_mm": 20})
    with pytest.raises(InputError, match="puts the camera inside"):
        sensor_family("flat_pad").parameters({"thickness_mm": 9, "camera_distance_mm": 14})
    again = pickle.loads(pickle.dumps(family))
    assert again.parameters().values() == defaults.values() and again.identity == family.identity


@pytest.mark.parametrize("like", sorted(sensor_families()))
def test_a_gel_can_be_like_every_sensor_of_the_catalogue(like: str) -> None:
    found = profile_parameters(imported(like))
    assert found.optics() is not None
    assert found.grid() == sensor_family(like).parameters().grid()


def test_what_was_measured_or_designed_is_where_studies_begin(folder: Path, tmp_path: Path) -> None:
    profile = load_profile(folder / "profile")
    measured = Provenance(
        kind="calibrated", method="presses", source="a press", inputs={"press.csv": "0" * 64},
        residuals={"rms_relative": 0.01}, valid_region={"depth_mm": (0.0, 1.0)},
    )  # fmt: skip
    stiff = profile.material.replace(young_modulus_pa=3.1e5, provenance=measured)
    found = family_of(profile.with_block(stiff), tmp_path).parameters()
    assert found.material().young_modulus_pa == pytest.approx(3.1e5)
    # A profile of the catalogue is that sensor with its values.
    family = family_of(catalogue_profile("gelsight", {"thickness_mm": 5.0}), tmp_path)
    assert family.parameters().pad().thickness_mm == 5.0
    assert family.parameters({"thickness_mm": 4.5}).pad().thickness_mm == 4.5


STUDY = """
study = { name = "mine", sensor = "./out", metrics = ["stiffness_secant"], load_n = 0.05 }
sweep.kind = "grid"
parameters.young_modulus_mpa.values = [0.1, 0.2]
"""


@pytest.mark.thorough
def test_a_study_takes_the_folder_beside_its_file(folder: Path) -> None:
    path = folder.parent / "study.toml"
    path.write_text(STUDY)
    designs = make_study(load_spec(path), default_kit()).points()
    assert len({point.id for point in designs}) == 2
    ball = coarse("sphere", depth_fraction=0.1, steps=2)
    ball = replace(ball, physics=replace(ball.physics, element=Element.LINEAR))
    results = evaluate_designs(designs, [ball], [METRICS["contact_area"]])
    soft, stiff = (result.records["sphere"][0].normal_n for result in results)
    assert stiff == pytest.approx(2 * soft) and soft.min() > 0
    # One simulation serves both, as of any sensor.
    assert [result.simulations for result in results] == [1, 0]
    path.write_text(STUDY.replace("young_modulus_mpa", "length_x_mm"))
    with pytest.raises(InputError, match=r"no parameter of .*'length_x_mm'"):
        make_study(load_spec(path), default_kit())


THICKNESSES_MM = (3.0, 4.0, 5.5)


def test_an_imported_gel_has_any_thickness(folder: Path) -> None:
    """Of a crowned block with upright walls: contact face and plan stay, the back moves."""
    family = sensor_family(str(folder))
    own = family.parameters().pad()
    area_mm2 = areas_mm2(own, Region.BOND, Region.WINDOW)
    for thickness_mm in THICKNESSES_MM:
        parameters = family.parameters({"thickness_mm": thickness_mm})
        pad = parameters.pad()
        assert isinstance(pad, MeshPad) and isinstance(own, MeshPad)
        down_mm = thickness_mm - own.thickness_mm
        assert pad.thickness_mm == thickness_mm == parameters.values()["thickness_mm"]
        assert pad.bounds_mm() == pytest.approx(own.bounds_mm() - [[0, 0, down_mm], [0, 0, 0]])
        for region in (Region.CONTACT, Region.BOND, Region.WINDOW):
            assert areas_mm2(pad, region) == pytest.approx(areas_mm2(own, region))
        face = own.mesh.region_nodes(Region.CONTACT)
        assert (pad.mesh.nodes_m[face] == own.mesh.nodes_m[face]).all()
        assert pad.volume_mm3() == pytest.approx(own.volume_mm3() + area_mm2 * down_mm)
        assert (pad.mesh.tets == own.mesh.tets).all() and pad.mesh.volumes_m3().min() > 0
    with pytest.raises(InputError, match=r"cannot be thickness_mm = 0\.3: its glued .* import-gel"):
        family.parameters({"thickness_mm": 0.3})
    with pytest.raises(InputError, match="thickness_mm"):
        family.parameters({"thickness_mm": 100})


def areas_mm2(pad: SurfacePad, *regions: Region) -> float:
    areas = pad.surface.areas_mm2()[np.isin(pad.surface.regions, [int(r) for r in regions])]
    return float(areas.sum())


@pytest.mark.thorough
def test_the_thickness_of_an_imported_gel_is_swept(folder: Path) -> None:
    path = folder.parent / "thickness.toml"
    path.write_text(STUDY.replace("young_modulus_mpa", "thickness_mm").replace("0.1, 0.2", "3, 5"))
    designs = make_study(load_spec(path), default_kit()).points()
    ball = coarse("sphere", depth_fraction=0.1, steps=2)
    ball = replace(ball, physics=replace(ball.physics, element=Element.LINEAR))
    results = evaluate_designs(designs, [ball], [METRICS["contact_area"]])
    # The deeper the gel, the deeper the ball: each is simulated.
    assert [result.simulations for result in results] == [1, 1]
    assert all(result.records["sphere"][0].normal_n.min() > 0 for result in results)


def test_a_study_of_another_gel_has_other_designs(folder: Path, tmp_path: Path) -> None:
    save_profile(imported(size=OTHER_SIZE, **MINE), tmp_path / "out" / "profile")
    ids = []
    for place in (folder.parent, tmp_path):
        (place / "ids.toml").write_text(STUDY)
        points = make_study(load_spec(place / "ids.toml"), default_kit()).points()
        ids.append({point.id for point in points})
    assert not ids[0] & ids[1]


@pytest.mark.thorough
def test_a_preview_of_it(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = ["preview", str(folder), "--out", str(out), "--size-px", "96", "--presses", "--json"]
    assert main(words) == 0
    stored = json.loads((out / "preview.json").read_text())
    assert stored["figures"]["pixel_size"]["value"] == pytest.approx(0.06, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("thickness_mm", [3.0, 4.0, 5.0])
def test_a_curved_pad_and_its_mesh_press_alike(thickness_mm: float) -> None:
    """The parametric pad, and its mesh of 4 mm as an imported gel: forces of one ball."""
    wanted = {"thickness_mm": thickness_mm}
    pads = (
        sensor_family("gelsight").parameters(SIZE | wanted),
        profile_sensor(imported()).parameters(wanted),
    )
    ball = coarse("sphere", depth_fraction=0.1, steps=2, mesh=SURFACE_PHYSICS.mesh)
    forces = []
    for parameters in pads:
        (job,) = press_jobs(ball, parameters)
        material = Material(REFERENCE_PA, 0.46)
        job = replace(job, setup=replace(job.setup, material=material, friction_coefficient=0.0))
        forces.append(simulate([job])[0].record.normal_n)
    assert forces[1] == pytest.approx(forces[0], rel=0.05)


def captures_of(folder: Path, sensor: str) -> Path:
    captures, _ = synthetic_captures(count=4)
    write_captures(folder, captures)
    manifest = folder / "captures.toml"
    lines = [line for line in manifest.read_text().splitlines() if not line.startswith("sensor")]
    manifest.write_text("\n".join([f'sensor = "{sensor}"', *lines]))
    return folder


def test_captures_name_the_folder_as_their_sensor(folder: Path, tmp_path: Path) -> None:
    captures = load_capture_folder(captures_of(tmp_path / "mine", str(folder)))
    assert captures.sensor == str(folder / "profile")
    assert base_profile(None, captures).sensor.name == "mine"
    assert base_profile(folder / "profile", captures) is not None
    facts = sensor_facts(captures.sensor)
    assert facts is not None and facts.thickness_mm == pytest.approx(4.0, abs=0.05)
    with pytest.raises(InputError, match="another gel"):
        base_profile(imported(size=OTHER_SIZE), captures)
    with pytest.raises(InputError, match="no folder of a profile"):
        load_capture_folder(captures_of(tmp_path / "other", "../nowhere"))
