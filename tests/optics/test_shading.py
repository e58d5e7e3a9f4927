# SPDX-License-Identifier: Apache-2.0
"""Rendered light against closed forms: points over a plane, shadows, coatings, exposure."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.optics.frames import turbid_reflectance
from taccel_lab.optics.render import OpticalModel
from taccel_lab.optics.shading_kernels import Gloss, glossy
from taccel_lab.profile.optical_design import Coating, Light, MarkerGrid
from tests.optics.flat_gel import GEL_MM, PLATE, design, model
from tests.support.formula_model import render_formula

UP, WHITE = (0.0, 0.0, 1.0), (1.0, 1.0, 1.0)
LAMP = Light((0.0, 0.0, -20.0), UP, WHITE)
RED = Light((8.0, 0.0, -6.0), (-0.8, 0.0, 0.6), (1.0, 0.2, 0.0), size_mm=(3.0, 1.0))
BLUE = Light((-6.0, 5.0, -8.0), (0.6, 0.0, 0.8), (0.0, 0.4, 1.0))


@pytest.mark.parametrize("lobe", [0.0, 1.0, 7.5])
def test_point_light_over_a_lambert_plane(lobe):
    tilt = math.radians(20)
    axis = np.array([math.sin(tilt), 0.0, math.cos(tilt)])
    light = Light((-3.0, 2.0, -9.0), tuple(axis.tolist()), (2.0, 1.0, 0.5), lobe=lobe)
    optics = model(design(light), refraction=False)
    image = optics.render()
    assert image.mask.all()
    way = image.points_mm.astype(np.float64) - light.position_mm
    distance = np.linalg.norm(way, axis=-1)
    intensity = (lobe + 1) / (2 * math.pi) * np.maximum(way @ axis / distance, 0) ** lobe
    irradiance = intensity / distance**2 * way[..., 2] / distance
    sight = image.points_mm - np.array(optics.camera.position_mm)
    falloff = (sight[..., 2] / np.linalg.norm(sight, axis=-1)) ** 4
    expected = (irradiance * falloff / math.pi)[..., None] * ([0.4, 0.5, 0.6] * np.array(light.rgb))
    np.testing.assert_allclose(image.linear, expected, rtol=2e-4)


def test_refracted_light_conserves_power_between_cones():
    field = model(design(Light((0.0, 0.0, -14.0), UP, WHITE), window=PLATE)).light_field()
    # Rays shot from the light by Snell's law alone, and what Fresnel lets through.
    angles = np.linspace(1e-4, 1.2, 200_001)
    heights, indices = [14.0 - 3.0 - GEL_MM, 3.0, GEL_MM], [1.0, 1.49, 1.41]
    bent = [np.arcsin(np.sin(angles) / n) for n in indices]
    reach = sum(h * np.tan(b) for h, b in zip(heights, bent, strict=True))
    share = np.ones_like(angles)
    for i in (0, 1):
        a, b, n, m = bent[i], bent[i + 1], indices[i], indices[i + 1]
        across = (n * np.cos(a) - m * np.cos(b)) / (n * np.cos(a) + m * np.cos(b))
        along = (m * np.cos(a) - n * np.cos(b)) / (m * np.cos(a) + n * np.cos(b))
        share = share * (1 - 0.5 * (across**2 + along**2))
    cone = np.cos(angles) / math.pi * np.sin(angles) * share
    irradiance = cone / (reach * np.gradient(reach, angles))
    radius = np.linalg.norm(field.points_mm[..., :2], axis=-1).astype(np.float64)
    expected = np.interp(radius, reach, irradiance)
    np.testing.assert_allclose(field.irradiance()[..., 0], expected, rtol=1e-3)
    # In the gel light arrives steeper than it would in air: sin(theta_gel) = sin(theta_air) / n.
    vector = field.vectors[15, 40, 0]
    sine = np.interp(radius[15, 40], reach, np.sin(angles)) / 1.41
    assert vector[0] / np.linalg.norm(vector) == pytest.approx(-sine, rel=1e-3)


def test_light_inside_the_window_bends_at_the_gel_only():
    # Straight above the source r -> 0: E = I / (n_w sum h / n)^2, and one interface to pass.
    inside, n, m = Light((0.0, 0.0, -GEL_MM - 2.0), UP, WHITE), 1.49, 1.41
    field = model(design(inside, window=PLATE)).light_field()
    apparent, passed = n * (2.0 / n + GEL_MM / m), 1 - ((n - m) / (n + m)) ** 2
    assert field.irradiance()[15, 20, 0] == pytest.approx(passed / math.pi / apparent**2, rel=1e-3)
    # Of the gel's own index the window bends nothing.
    same = model(design(inside, window=replace(PLATE, refractive_index=m))).light_field()
    offset = same.points_mm.astype(np.float64) - inside.position_mm
    distance = np.linalg.norm(offset, axis=-1)
    expected = (offset[..., 2] / distance) ** 2 / math.pi / distance**2
    np.testing.assert_allclose(same.irradiance()[..., 0], expected, rtol=1e-3)


@pytest.mark.thorough
def test_a_step_throws_its_shadow():
    step, edge, source_x, depth = 1.0, 1.0, 9.0, 6.0

    def stepped(xy):
        return -step * np.clip((xy[..., 0] - edge) / 0.05, 0.0, 1.0)

    way = np.array([-source_x, 0.0, depth]) / math.hypot(source_x, depth)
    light = design(Light((source_x, 0.0, -depth), tuple(way.tolist()), WHITE))
    options = {"refraction": False, "step_mm": 0.05, "half": 12.0, "size_px": (164, 124)}
    lit = model(light, stepped, **options).light_field()
    x, value = lit.points_mm[62, :, 0], lit.irradiance()[62, :, 0]
    # The upper end of the wall shades a strip whose far end the light passes just over.
    end = edge - step * (source_x - edge) / (depth - step)
    shaded = (x > end + 0.1) & (x < edge - 0.1)
    free = ((x < end - 0.1) & (x > -8)) | ((x > edge + 0.2) & (x < 6))
    assert shaded.sum() > 5
    np.testing.assert_allclose(value[shaded], 0.0)
    assert (value[free] > 0).all()
    assert lit.blocked[62][shaded] == pytest.approx(lit.facing[62][shaded])
    without = model(light, stepped, shadows=False, **options).light_field()
    assert (without.irradiance()[62, :, 0][shaded] > 0).all()


def test_light_adds_up_and_scales():
    gloss = Coating((0.4, 0.5, 0.6), specular=0.3, roughness=0.4)

    def linear(*lights, ambient=0.0):
        optics = design(*lights, coating=gloss, window=PLATE, ambient_rgb=(ambient,) * 3)
        return model(optics).render().linear.astype(np.float64)

    red, red_ambient = linear(RED), linear(RED, ambient=0.5)
    np.testing.assert_allclose(linear(RED, BLUE), red + linear(BLUE), rtol=1e-5, atol=1e-9)
    strong = linear(replace(RED, rgb=(3.0, 0.6, 0.0)), ambient=0.5)
    np.testing.assert_allclose(strong, 3 * red_ambient, rtol=1e-5, atol=1e-9)
    # Ambient light is a share of the mean direct light.
    assert (red_ambient - red)[..., 2].max() == 0.0 < (red_ambient - red)[..., 0].min()


def test_renders_are_equal_to_the_bit():
    optics = design(RED, BLUE, window=PLATE)
    first, again = model(optics).render(), model(optics)
    second = again.render()
    assert first.rgb.tobytes() == second.rgb.tobytes() == again.rest_rgb.tobytes()
    assert first.linear.tobytes() == second.linear.tobytes()


@wp.kernel(enable_backward=False)
def _glossy_albedo_kernel(
    gloss: Gloss, cosine: float, steps: int, total: wp.array(dtype=wp.float64)
):
    i, j = wp.tid()
    z = (float(i) + 0.5) / float(steps)
    phi = (float(j) + 0.5) / float(steps) * 6.2831853
    sine = wp.sqrt(1.0 - z * z)
    light = wp.vec3(sine * wp.cos(phi), sine * wp.sin(phi), z)
    eye = wp.vec3(wp.sqrt(1.0 - cosine * cosine), 0.0, cosine)
    value = glossy(wp.vec3(0.0, 0.0, 1.0), light, eye, gloss) * z
    wp.atomic_add(total, 0, wp.float64(value * 6.2831853 / float(steps * steps)))


@pytest.mark.parametrize("roughness", [0.15, 0.5])
def test_the_glossy_lobe_makes_no_light(roughness):
    gloss = Gloss()
    gloss.weight, gloss.alpha2 = 1.0, roughness**2
    reflected = []
    for cosine in (1.0, 0.7):
        total = wp.zeros(1, dtype=wp.float64, device="cpu")
        inputs = [gloss, cosine, 400, total]
        wp.launch(_glossy_albedo_kernel, dim=(400, 400), inputs=inputs, device="cpu")
        reflected.append(total.numpy()[0])
    # Facets steeper than 45 deg, a share of 1 - 1 / (1 + alpha^2), send light from straight above
    # below the horizon; masking takes a little more.
    most = 1 / (1 + gloss.alpha2)
    assert 0.85 * most < reflected[0] < most and reflected[1] < 1


def test_markers_are_dark_round_and_where_they_belong():
    dots = MarkerGrid(3, 3, 6.0, 5.0, 1.5, offset_mm=(0.5, -0.5))
    plain, image = (
        model(design(LAMP), refraction=False, size_px=(164, 124), markers=markers).render()
        for markers in (None, dots)
    )
    ratio = image.linear[..., 1] / plain.linear[..., 1]
    xy = image.points_mm[..., :2]
    distance = np.linalg.norm(xy[:, :, None] - dots.points_mm(), axis=-1).min(axis=-1)
    soft = 30.0 / 240.0
    np.testing.assert_allclose(ratio[distance < 1.5 - soft], 0.05, rtol=1e-3)
    np.testing.assert_allclose(ratio[distance > 1.5 + soft], 1.0, rtol=1e-5)
    # Nine dots of pi r^2.
    area = (1 - ratio).sum() / 0.95 * soft**2
    assert area == pytest.approx(9 * math.pi * 1.5**2, rel=0.01)


def test_turbid_gel_over_black_skin_darkens_where_it_is_thin():
    # Kubelka and Munk: over black R = s / (s + 1); thick layers are white; none shows the skin.
    for skin, depth, wanted in ((0.0, 2.0, 2 / 3), (0.3, 0.0, 0.3), (0.3, 1e6, 1.0)):
        assert turbid_reflectance(np.array(skin), np.array(depth)) == pytest.approx(wanted)

    def dented(xy):
        return -1.5 * np.exp(-np.sum(xy**2, axis=-1) / 4.0)

    # From afar, so that the dent's middle is hardly nearer to the light.
    far, black = Light((0.0, 0.0, -400.0), UP, WHITE), Coating((0.02, 0.02, 0.02))
    optics = design(far, coating=black, gel_scattering_per_mm=0.5)
    turbid = model(optics, dented)
    image = turbid.render()
    s = 0.5 * (image.points_mm[15, 20, 2] + GEL_MM)
    found = turbid.reflectance(turbid.light_field())[15, 20, 0]
    assert found == pytest.approx((0.98 * s + 0.02) / (0.98 * s + 1), rel=1e-5)
    assert image.linear[15, 20, 0] < 0.85 * model(optics).render().linear[15, 20, 0]


def test_other_formulas_keep_the_exposure():
    def lower(xy):
        return np.full(xy.shape[:-1], -1.0)

    optics = model(design(RED, BLUE, window=PLATE))
    pressed = render_formula(optics, lower, (15.0, 15.0), 0.5)
    assert np.nanmax(pressed.points_mm[..., 2]) == pytest.approx(-1.0, abs=1e-5)
    alone = model(design(RED, BLUE, window=PLATE), lower).render()
    np.testing.assert_allclose(pressed.linear, alone.linear, rtol=1e-5)
    assert (pressed.rgb != alone.rgb).any()
    np.testing.assert_array_equal(optics.render().rgb, optics.picture(optics.light_field()).rgb)


@pytest.mark.parametrize("balance", ["gray", "none"])
def test_exposure_puts_the_median_at_its_level(balance):
    optics = design(RED, replace(BLUE, rgb=(0.0, 0.1, 0.2)), window=PLATE)
    image = model(optics, level=90.0, white_balance=balance).render()
    medians = np.median(image.rgb[image.mask], axis=0)
    assert medians.max() == pytest.approx(90, abs=1)
    assert (medians.min() >= 89) if balance == "gray" else (medians.min() < 80)


BACK = replace(design(LAMP).camera, rotation=(1.0, 0.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (partial(model, design(LAMP), samples=0), "samples"),
        (partial(model, design(LAMP), size_px=(1, 10)), "size_px"),
        (partial(model, design(LAMP), level=300), "level"),
        (partial(model, design(LAMP), gamma=0.1), "gamma"),
        (partial(model, design(replace(LAMP, direction=(0.0, 0.0, -1.0)))), "no light reaches"),
        (partial(model, design(LAMP, camera=BACK)), "sees the gel's contact face"),
        (lambda: model(design(LAMP)).render(np.zeros((4, 3))), "no nodes to move"),
        (partial(OpticalModel, design(LAMP), None), "needs a mesh"),
    ],
)
def test_input_that_shows_nothing(call, words):
    with pytest.raises(InputError, match=words):
        call()
