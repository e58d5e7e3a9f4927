# SPDX-License-Identifier: Apache-2.0
"""What is exported is read back by its consumer's convention, from samples without symmetry."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml
from scipy.spatial.transform import Rotation

from taccel_lab.camera.gel_camera import CameraModel, apparent_distance_mm
from taccel_lab.datasets.exports import export_lerobot, export_univtac
from taccel_lab.datasets.reading import Dataset
from taccel_lab.exporters import gs_sdk
from taccel_lab.exporters.export import EXPORTERS, export_profile
from taccel_lab.exporters.taxim_table import TABLE_FILE, TableFile, TaximTable, write_table
from taccel_lab.profile import SensorProfile, save_profile
from tests.exporters.consumers import LINK, TACCEL, TaccelPad, decoded, opencv_values
from tests.exporters.profiles import TURN
from tests.support.small_data_sets import make, small_profile

SCALE = (0.07 * 0.055) ** 0.5
"""That of square pixels of the same area, where the consumer has one."""
POINTS_MM = np.array([[0.0, 0, 0], [4, -3, 0], [-5, 6, -1], [2, 2, -0.5]])


def close(found: Any, wanted: Any, atol: float = 1e-9) -> None:
    np.testing.assert_allclose(found, wanted, rtol=1e-7, atol=atol)


def middle_mm(profile: SensorProfile) -> np.ndarray:
    """Gel under the middle of the image, whose pixel (150, 125) is over the origin."""
    assert profile.camera.center_u_px == 150 and profile.camera.center_v_px == 125
    return np.array([(159.5 - 150) * 0.07, (119.5 - 125) * 0.055, 0.0])


def distance_mm(profile: SensorProfile) -> float:
    assert profile.optics is not None
    return apparent_distance_mm(profile.optics, profile)


def camera_m(profile: SensorProfile) -> np.ndarray:
    """Where a camera without refraction stands, in the link [m]."""
    place = middle_mm(profile) - distance_mm(profile) * TURN.as_matrix()[:, 2]
    return 1e-3 * LINK @ place


def tacto(out: Path, profile: SensorProfile) -> None:
    sensor = yaml.safe_load((out / "config.yml").read_text())["sensor"]
    (camera,) = sensor["camera"]
    assert camera["cam0"] is None and profile.lights is not None
    # It looks along its own -z, y up, and its one angle of view is that of the rows.
    turn = Rotation.from_euler("xyz", camera["orientation"], degrees=True).as_matrix()
    close(turn, LINK @ TURN.as_matrix() @ np.diag([1, -1, -1]))
    close(camera["position"], camera_m(profile))
    close(math.tan(math.radians(camera["yfov"]) / 2), 240 * 0.055 / 2 / distance_mm(profile))
    lamps, given = sensor["lights"], np.array([led.rgb for led in profile.lights.led])
    assert lamps["polar"] is False and camera["lightIDList"] == [0, 1, 2]
    close(lamps["xyz"]["coords"], [1e-3 * LINK @ led.position_mm for led in profile.lights.led])
    # Colour times intensity is the lamp's light over the brightest channel of all.
    shown = np.array(lamps["colors"]) * np.array(lamps["intensities"])[:, None]
    close(shown, given / given.max())
    assert np.ptp(lamps["intensities"]) > 0.5
    assert sensor["noise"]["color"] == {"mean": 0, "std": 1.7}
    close(sensor["force"]["max_deformation"], 1e-3)


def isaac_lab(out: Path, profile: SensorProfile) -> None:
    cfg = json.loads((out / "sensor_cfg.json").read_text())
    camera, render, sensor = cfg["camera_cfg"], cfg["render_cfg"], cfg["sensor_cfg"]
    # ROS: z along the view, x right.
    turn = Rotation.from_quat(camera["offset_quat_xyzw"]).as_matrix()
    close(turn, LINK @ TURN.as_matrix())
    close(camera["offset_pos_m"], camera_m(profile))
    close(1e3 * camera["distance_m"], distance_mm(profile))
    focal = camera["focal_length"] / camera["horizontal_aperture"]
    close(distance_mm(profile) / focal, 320 * 0.07)
    close(render["mm_per_pixel"], SCALE)
    assert (render["image_width"], render["image_height"]) == (320, 240)
    assert sensor["tactile_array_size"] == [7, 9] and sensor["friction_coefficient"] == 0.7
    # E A / t of 1/63 of the gel of 25.25 x 20.75 x 4 mm; G / E = 1 / (2 (1 + nu)).
    stiffness = 3.1e5 * 25.25e-3 * 20.75e-3 / 63 / 4e-3
    assert sensor["normal_contact_stiffness"] == pytest.approx(stiffness, rel=0.02)
    close(sensor["normal_contact_stiffness"] / sensor["tangential_stiffness"], 2 * 1.37)


def opencv(out: Path, profile: SensorProfile) -> None:
    found = opencv_values(out / "camera.yaml")
    assert profile.optics is not None and found["model"] == profile.optics.model
    fisheye = found["model"] == "fisheye"
    project = cv2.fisheye.projectPoints if fisheye else cv2.projectPoints
    image, _ = project(
        POINTS_MM[:, None], found["rvec"], found["t"], found["camera_matrix"],
        found["distortion_coefficients"],
    )  # fmt: skip
    close(np.asarray(image)[:, 0], CameraModel(profile.optics.camera()).project(POINTS_MM), 1e-6)
    size = profile.optics.width_px, profile.optics.height_px
    assert (found["image_width"], found["image_height"]) == size and size[0] != size[1]
    close(cv2.Rodrigues(found["rvec"])[0], found["R"], 1e-12)
    close(found["R"], TURN.inv().as_matrix(), 1e-12)
    close(found["t"].ravel(), -TURN.inv().apply([0.5, -1.0, -22.0]))
    uv = (POINTS_MM * [1, 1, 0] + [0, 0, 1]) @ found["pixel_from_gel"].T
    close(uv[:, :2], POINTS_MM[:, :2] / [0.07, 0.055] + [150, 125])
    close(found["mm_per_px"], [[0.07, 0.055]])
    raw = profile.optics.raw_width_px, profile.optics.raw_height_px
    assert (found["raw_width"], found["raw_height"]) == raw and raw[0] != raw[1]
    assert (found["crop_x"], found["crop_y"], found["sensor"]) == (0.9, 0.8, "gelsight_mini")
    assert (found["tactile_width"], found["tactile_height"]) == (320, 240)
    assert found["gel_refractive_index"] == profile.optics.gel_refractive_index


def urdf(out: Path, profile: SensorProfile) -> None:
    yourdfpy = pytest.importorskip("yourdfpy")
    robot = yourdfpy.URDF.load(str(out / "sensor.urdf"), load_collision_meshes=True)
    assert robot.validate() and robot.base_link == "sensor_link"
    turned = np.eye(4)
    turned[:3, :3] = LINK
    close(robot.get_transform("gel_frame", "sensor_link"), turned)
    close(robot.get_transform("gel", "sensor_link"), np.eye(4), 1e-12)
    camera = robot.get_transform("camera_optical_frame", "gel_frame")
    close(camera[:3, :3], TURN.as_matrix(), 1e-6)
    close(camera[:3, 3], [0.5e-3, -1e-3, -22e-3])


def taccel(out: Path, profile: SensorProfile) -> None:
    pad = TaccelPad(out)
    config = {key: pad.config[key] for key in ("E", "nu", "mu", "density", "cam_h", "cam_w")}
    assert tuple(config.values()) == (3.1e5, 0.37, 0.7, 1234.0, 320, 320)
    close(pad.config["cam_pixel_size"], SCALE)
    half_mm = 320 * SCALE / 2
    close(pad.config["cam_fov"], np.degrees(2 * np.arctan(half_mm / distance_mm(profile))))
    assert profile.markers is not None and pad.config["with_marker"] is True
    assert pad.metadata["marker_vert_idx"].shape == (61, 3)
    places = 1e3 * pad.markers() @ TACCEL + middle_mm(profile)
    close(places[:, :2], profile.markers.grid().points_mm())
    close(pad.metadata["marker_bc_coords"].sum(axis=1), 1.0)


def taxim(out: Path, profile: SensorProfile) -> None:
    params = json.loads((out / "params.json").read_text())["sensor"]
    assert (params["w"], params["h"], params["num_bins"]) == (320, 240, 9)
    close(params["pixmm"], SCALE)
    gel = np.load(out / "gelmap.npy")
    assert gel.shape == (240, 320)
    close(gel, 4.0 / SCALE)
    assert profile.background_rgb is not None
    f0 = np.load(out / "dataPack.npz")["f0"][..., ::-1]
    assert np.abs(f0 - profile.background_rgb).max() <= 0.5


def gs_sdk_files(out: Path, profile: SensorProfile) -> None:
    device = yaml.safe_load((out / "device.yaml").read_text())
    assert device.pop("ppmm") == pytest.approx(SCALE)
    assert device == {
        "device_name": "gelsight_mini", "imgh": 240, "imgw": 320, "raw_imgh": 2464,
        "raw_imgw": 3280, "framerate": 25,
    }  # fmt: skip
    assert profile.background_rgb is not None
    bgr = np.asarray(cv2.imread(str(out / "background.png")))
    assert np.abs(bgr[..., ::-1] - profile.background_rgb).max() <= 0.5


CONSUMERS: dict[str, Callable[[Path, SensorProfile], None]] = {
    "tacto": tacto, "isaac-lab": isaac_lab, "opencv": opencv, "urdf": urdf, "taccel": taccel,
    "taxim": taxim, "gs-sdk": gs_sdk_files,
}  # fmt: skip


@pytest.mark.parametrize("to", CONSUMERS)
def test_a_profile_is_read_back(
    to: str, skewed: SensorProfile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # What the two networks show is looked at where they are rendered.
    quick = partial(gs_sdk.export_gs_sdk, steps=1, samples=200)
    monkeypatch.setitem(EXPORTERS, "gs-sdk", replace(EXPORTERS["gs-sdk"], write=quick))
    table = None
    if to == "taxim":
        table = tmp_path / TABLE_FILE
        write_table(TableFile(TaximTable(9, np.ones((3, 9, 9, 6)))), table)
    document = export_profile(skewed, to, tmp_path / "out", table=table)
    CONSUMERS[to](tmp_path / "out", skewed)
    stated = document["approximations"].get("scale_difference", 0.07 / 0.055 - 1)
    assert stated == pytest.approx(0.07 / 0.055 - 1)


def test_a_fisheye_is_read_back(skewed: SensorProfile, tmp_path: Path) -> None:
    assert skewed.optics is not None
    fisheye = skewed.with_block(skewed.optics.replace(model="fisheye"))
    export_profile(fisheye, "opencv", tmp_path / "out")
    opencv(tmp_path / "out", fisheye)


def test_every_format_has_a_row() -> None:
    """Networks are run and rebuilt in ``test_networks.py``."""
    assert set(CONSUMERS) | {"onnx", "safetensors"} == set(EXPORTERS)


# Data sets ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def touches(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two touches by a tool that leans, seen by a camera of pixels that are not square."""
    folder = tmp_path_factory.mktemp("touches")
    profile = small_profile()
    camera = profile.camera.replace(mm_per_px_y=0.8 * profile.camera.mm_per_px_x)
    save_profile(profile.with_block(camera), folder / "pad")
    leaning = {"tool": "sphere:3", "tilt_deg": [4, 6], "yaw_deg": [30, 60]}
    make(folder / "pad", folder / "data", dataset={"episodes": 2}, objects=[leaning])
    return folder / "data"


def lerobot(touches: Path, out: Path) -> None:
    data = Dataset(touches)
    export_lerobot([touches], out, fps=5)
    frames = pq.read_table(out / "data" / "chunk-000" / "file-000.parquet")

    def column(name: str) -> np.ndarray:
        return np.array(frames[name].to_pylist())

    images = [decoded(cell["bytes"]) for cell in frames["observation.images.tactile"].to_pylist()]
    assert (np.stack(images)[..., ::-1] == data.read("rgb", slice(None))).all()
    state = column("observation.state")
    close(state, data.read("command", slice(None)), 1e-6)
    for place in range(2):
        rows = data.rows_of(place)
        close(column("action")[rows], state[[*rows[1:], rows[-1]]])
        close(column("timestamp")[rows], np.arange(len(rows)) / 5, 1e-7)
        assert set(column("episode_index")[rows]) == {place}
    for name in ("wrench", "tool_pose", "patch_forces_n", "contact_area_mm2"):
        found = column(f"observation.{name}").reshape(len(data), -1)
        close(found, data.read(name, slice(None)).reshape(len(data), -1), 1e-6)


def univtac(touches: Path, out: Path) -> None:
    data = Dataset(touches)
    assert export_univtac([touches], out) == 2
    rows = data.rows_of(1)
    optics, ours = data.profile(1).optics, data.read("tool_pose", rows)
    assert optics is not None
    with h5py.File(out / "hdf5" / "1.hdf5") as file:
        gel = file["tactile/left_tactile"]
        # Channels in the order in which they were handed to the encoder.
        images = [decoded(png) for png in gel["rgb"][()]]
        assert (np.stack(images) == data.read("rgb", rows)).all()
        distance = abs(optics.position_mm[2]) - data.read("depth_mm", rows)
        close(gel["depth"][()], distance, 1e-5)
        assert gel["marker"].shape[:2] == (len(rows), 2)
        assert file["step"][()].tolist() == list(range(len(rows)))
        assert file["atom/tag"][0] == b"rest" and file["atom/id"][:2].tolist() == [0, 1]
        assert (file["taccel_lab/wrench"][()] == data.read("wrench", rows)).all()
        still, theirs = gel["pose"][()], file["embodiment/ee"][()]
        assert (file["actor/object"][()] == theirs).all()
    # Their quaternions begin with w.
    close(theirs[:, :3], ours[:, :3], 1e-7)
    turns = Rotation.from_quat(theirs[:, 3:], scalar_first=True).as_rotvec()
    close(turns, Rotation.from_quat(ours[:, 3:]).as_rotvec(), 1e-6)
    assert np.linalg.norm(turns, axis=1).min() > np.radians(4)
    assert Rotation.from_quat(still[:, 3:], scalar_first=True).magnitude().max() == 0
    assert len(json.loads((out / "metadata.json").read_text())) == 2


@pytest.mark.thorough(cases=("lerobot",))
@pytest.mark.parametrize("reader", [lerobot, univtac], ids=["lerobot", "univtac"])
def test_a_data_set_is_read_back(
    reader: Callable[[Path, Path], None], touches: Path, tmp_path: Path
) -> None:
    reader(touches, tmp_path / "out")
