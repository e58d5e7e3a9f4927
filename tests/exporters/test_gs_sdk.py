# SPDX-License-Identifier: Apache-2.0
"""gs_sdk's network loads into its architecture and reads a press at the right place and sign."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from taccel_lab.exporters import gs_sdk
from taccel_lab.exporters.press_samples import ColorSource
from taccel_lab.profile import SensorProfile
from tests.exporters.profiles import CIRCLE, our_image, press_over_rest


class BgrxyNetwork(torch.nn.Module):
    """5-32-32-32-2 with ReLU, layers fc1 to fc4: what gs_sdk loads the file into."""

    def __init__(self) -> None:
        super().__init__()
        self.fc1 = torch.nn.Linear(5, 32)
        self.fc2 = torch.nn.Linear(32, 32)
        self.fc3 = torch.nn.Linear(32, 32)
        self.fc4 = torch.nn.Linear(32, 2)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        for layer in (self.fc1, self.fc2, self.fc3):
            x = torch.relu(layer(x))
        return self.fc4(x)


def gradients(network: BgrxyNetwork, bgr: np.ndarray) -> np.ndarray:
    """Slopes along columns and rows of every pixel, shape [h, w, 2]."""
    height, width = bgr.shape[:2]
    x, y = np.meshgrid(
        np.linspace(0, 1, width, endpoint=False), np.linspace(0, 1, height, endpoint=False)
    )
    features = np.concatenate([bgr / 255, x[..., None], y[..., None]], axis=-1)
    with torch.no_grad():
        return np.tan(network(torch.from_numpy(features.astype(np.float32))).numpy())


@pytest.fixture(scope="module")
def folder(mini: SensorProfile, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("gs_sdk")
    torch.set_num_threads(1)
    record = gs_sdk.export_gs_sdk(mini, out, steps=800, samples=20_000)
    assert record.approximations["normal_mean_deg"] < 2.5
    # It learns angles, not slopes: those that presses have, on average.
    slope = ColorSource(mini).draw(np.random.default_rng(1), 20_000, gs_sdk.IN_CONTACT).slope
    tilt_deg = np.degrees(np.arctan(np.linalg.norm(slope, axis=1)))
    drawn_deg = tilt_deg[tilt_deg > np.degrees(1e-3)].mean()
    assert record.approximations["tilt_mean_deg"] == pytest.approx(drawn_deg, rel=0.03)
    assert drawn_deg > 5
    return out


def test_it_learns_angles_from_blue_green_and_red(mini, tmp_path, monkeypatch) -> None:
    learned, train = [], gs_sdk.train_network
    monkeypatch.setattr(
        gs_sdk, "train_network", lambda *seen, **some: learned.append(seen) or train(*seen, **some)
    )
    gs_sdk.export_gs_sdk(mini, tmp_path, steps=1, samples=500)
    features, angles = learned[0]
    drawn = ColorSource(mini).draw(np.random.default_rng(0), 500, gs_sdk.IN_CONTACT)
    tilted = angles.any(axis=1)
    np.testing.assert_allclose(np.tan(angles[tilted]), drawn.slope[tilted], rtol=1e-5)
    rest = mini.background_rgb.reshape(-1, 3)[drawn.pixel_idx[~tilted]]
    assert (~tilted).sum() > 50 and np.ptp(rest, axis=1).min() > 10
    np.testing.assert_allclose(255 * features[~tilted, :3], rest[:, ::-1], atol=6)


@pytest.mark.thorough
def test_the_network_reads_the_press(mini: SensorProfile, folder: Path) -> None:
    network = BgrxyNetwork()
    state = torch.load(folder / "nnmodel.pth", weights_only=True)
    network.load_state_dict(state, strict=True)
    background = np.asarray(cv2.imread(str(folder / "background.png")))
    press = press_over_rest(mini)
    image = np.rint(our_image(mini, press))[..., ::-1]
    found = gradients(network, image) - gradients(network, background)
    truth = -press.normals[..., :2] / press.normals[..., 2:]
    v, u = np.mgrid[0:240, 0:320]
    inside = np.hypot(u - CIRCLE.u_px, v - CIRCLE.v_px) < CIRCLE.radius_px

    def normal(slope: np.ndarray) -> np.ndarray:
        raw = np.concatenate([-slope, np.ones((*slope.shape[:-1], 1))], axis=-1)
        return raw / np.linalg.norm(raw, axis=-1, keepdims=True)

    def angle_deg(slope: np.ndarray) -> float:
        cosine = (normal(slope) * normal(truth)).sum(axis=-1)[inside]
        return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))).mean())

    flat = angle_deg(np.zeros_like(truth))
    assert flat > 15
    assert angle_deg(found) < 4
    assert angle_deg(-found) > flat and angle_deg(found[..., ::-1]) > 2 * angle_deg(found)
