# SPDX-License-Identifier: Apache-2.0
"""Pressed edges are found where they were drawn, and give the scale in x and y."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.calibration.capture.folder import EdgeCapture, Frame
from taccel_lab.calibration.capture.schema import EdgeEntry, LineEntry
from taccel_lab.calibration.scale.edge_line import find_edge
from taccel_lab.calibration.scale.edges import measure_edges, scale_from_edges
from taccel_lab.errors import InputError
from taccel_lab.reading.images import read_image
from tests.calibration.drawn.faults import add_dust, add_noise, blur, poison, quantise
from tests.support.real_data import real_data

BACKGROUND = np.full((240, 320, 3), (90.0, 120.0, 130.0))


def drawn_edge(
    ends: np.ndarray, *, decay_px: float = 1.5, noise: float = 1.5, seed: int = 0
) -> np.ndarray:
    """Two faces that meet in a sharp crest; beyond the ends the gel comes off it."""
    rng = np.random.default_rng(seed)
    v, u = np.mgrid[:240, :320].astype(float)
    along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    across = np.array([-along[1], along[0]])
    t = (u - ends[0][0]) * along[0] + (v - ends[0][1]) * along[1]
    d = (u - ends[0][0]) * across[0] + (v - ends[0][1]) * across[1]
    beyond = np.maximum(np.maximum(-t, t - np.linalg.norm(ends[1] - ends[0])), 0.0)
    height = np.exp(-beyond / decay_px)
    side = np.clip(d, -0.5, 0.5) * 2
    width = np.exp(-np.maximum(np.abs(d) - 12.0, 0.0) / 4.0)
    face = np.where(
        side[..., None] > 0, np.array([55.0, -30.0, -40.0]), np.array([-45.0, 10.0, 60.0])
    )
    image = BACKGROUND + face * (np.abs(side) * width * height)[..., None]
    image = add_dust(blur(image, 0.7), 8, rng)
    return quantise(add_noise(image, noise, rng))


@settings(max_examples=15, deadline=None)
@given(
    u=st.floats(120, 200),
    v=st.floats(95, 145),
    angle=st.floats(-90, 90),
    length=st.floats(60, 130),
    seed=st.integers(0, 99),
)
def test_ends_are_found_within_their_uncertainty(
    u: float, v: float, angle: float, length: float, seed: int
) -> None:
    direction = np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle))])
    ends = np.array([u, v]) + np.array([[-0.5], [0.5]]) * length * direction
    found = find_edge(drawn_edge(ends, seed=seed), BACKGROUND)
    sigma = np.hypot(found.length_sigma_px, found.systematic_px)
    assert abs(found.length_px - length) < max(4 * sigma, 2.0)
    assert np.linalg.norm(found.ends_px.mean(axis=0) - (u, v)) < 1.5
    turn = (found.angle_deg - angle + 90) % 180 - 90
    assert abs(turn) < 1.0


def test_masked_pixels_have_no_effect() -> None:
    ends = np.array([[90.0, 100.0], [220.0, 130.0]])
    mask = np.ones((240, 320), dtype=bool)
    mask[180:, :] = False
    image = drawn_edge(ends)
    clean = find_edge(image, BACKGROUND, mask=mask)
    poisoned = quantise(poison(image, mask, np.random.default_rng(0)))
    dirty = find_edge(poisoned, BACKGROUND, mask=mask)
    np.testing.assert_allclose(dirty.ends_px, clean.ends_px, atol=0.3)


@pytest.mark.parametrize(
    ("image", "reason"),
    [
        (quantise(add_noise(BACKGROUND, 2.0, np.random.default_rng(0))), "no edge"),
        (BACKGROUND.astype(np.uint8), "nothing changes sharply"),
        (drawn_edge(np.array([[40.0, 120.0], [340.0, 125.0]])), "runs out|no end"),
        (np.zeros((100, 320, 3), np.uint8), "of one size"),
    ],
)
def test_pictures_without_a_whole_edge_are_refused(image: np.ndarray, reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        find_edge(image, BACKGROUND)


def captured(images: list[np.ndarray], labels: list[LineEntry | None] | None = None):
    labels = labels or [None] * len(images)
    return [
        EdgeCapture(
            EdgeEntry(image=f"e{k}.png", length_mm=10.0, line=label),
            Frame(f"e{k}", f"e{k}.png", f"{k:064d}", lambda image=image: image),
        )
        for k, (image, label) in enumerate(zip(images, labels, strict=True))
    ]


def edges_at(scale: tuple[float, float], angles: list[float], share: float = 1.0) -> list:
    images = []
    for k, angle in enumerate(angles):
        direction = np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle))])
        direction = direction / np.linalg.norm(direction * scale) * 10.0
        if k == 0:
            direction = direction * share
        middle = np.array([160.0 + 3 * k, 118.0 + 2 * k])
        images.append(
            drawn_edge(middle + np.array([[-0.5], [0.5]]) * direction, decay_px=0.5, seed=k)
        )
    return images


def test_scale_in_x_and_y_and_an_edge_that_touched_in_part() -> None:
    truth = (0.085, 0.080)
    images = edges_at(truth, [5, -10, 20, 80, 95, 60, -45], share=0.8)
    found = scale_from_edges(*measure_edges(captured(images), BACKGROUND, None))
    assert found.x is not None and found.y is not None
    assert abs(found.x.value - truth[0]) < 3 * found.x.sigma
    assert abs(found.y.value - truth[1]) < 3 * found.y.sigma
    assert found.x.sigma < 0.015 * truth[0]
    assert found.x.value > found.y.value
    used = [edge["used"] for edge in found.evidence["edges"]]
    assert used == [False] + [True] * 6
    assert any(remark.code == "edges_short" for remark in found.remarks)


def test_edges_along_one_axis_only_say_so() -> None:
    images = edges_at((0.085, 0.085), [2, -5, 8, 0, 4])
    found = scale_from_edges(*measure_edges(captured(images), BACKGROUND, None))
    assert found.x is not None and found.y is not None
    assert found.y.sigma > 2 * found.x.sigma
    assert any(remark.code == "edges_not_along_y" for remark in found.remarks)


def test_a_drawn_line_stands_in_for_an_edge_that_is_not_found() -> None:
    empty = quantise(add_noise(BACKGROUND, 2.0, np.random.default_rng(0)))
    label = LineEntry(u_px=160, v_px=120, length_px=125.0, angle_deg=0.0)
    measured, refused = measure_edges(captured([empty], [label]), BACKGROUND, None)
    assert not refused and measured[0].line.length_px == pytest.approx(125.0)
    measured, refused = measure_edges(captured([empty]), BACKGROUND, None)
    assert not measured and "no edge" in refused[0]
    with pytest.raises(InputError, match="no pressed edge"):
        scale_from_edges(measured, refused)


def test_real_cube_edges_without_clicking() -> None:
    """Against hand-drawn lines, which the fit does not see, and the published 0.0634 mm/px."""
    cube = real_data("gsmini_cube_edges")
    background = read_image(cube / "background.png")
    captures, labels = [], []
    for folder in sorted(path for path in cube.iterdir() if path.is_dir()):
        image = read_image(folder / "gelsight.png")
        captures += captured([image])
        labels.append(float(np.load(folder / "label.npz")["line_length"]))
    measured, refused = measure_edges(captures, background, None)
    assert len(refused) <= 1
    found = scale_from_edges(measured, refused)
    assert found.x is not None and found.y is not None
    for scale in (found.x, found.y):
        assert 0.0618 < scale.value < 0.0640
        assert scale.sigma < 0.015 * scale.value
    assert abs(np.median([edge.line.length_px for edge in measured]) - np.median(labels)) < 3.0
