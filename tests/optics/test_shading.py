# SPDX-License-Identifier: Apache-2.0
"""Rendered light against closed forms."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.optics.frames import turbid_reflectance
from taccel_lab.optics.light_samples import sample_lights
from taccel_lab.optics.render import OpticalModel
from taccel_lab.optics.shading_kernels import Gloss, glossy
from taccel_lab.profile.optical_design import Coating, Light, MarkerGrid
from tests.optics.flat_gel import GEL_MM, PLATE, design, model
from tests.support.formula_model import render_formula

UP = (0.0, 0.0, 1.0)


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
    for c, (albedo, power) in enumerate(zip((0.4, 0.5, 0.6), light.rgb, strict=True)):
        expected = albedo / math.pi * power * irradiance * falloff
        np.testing.assert_allclose(image.linear[..., c], expected, rtol=2e-4)


def test_refracted_light_conserves_power_between_cones():
    light = Light((0.0, 0.0, -14.0), UP, (1.0, 1.0, 1.0))
    optics = model(design(light, window=PLATE))
    field = optics.light_field()
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
    row, column = 15, 40
    vector = field.vectors[row, column, 0]
    sine = np.interp(radius[row, column], reach, np.sin(angles)) / 1.41
    assert vector[0] / np.linalg.norm(vector) == pytest.approx(-sine, rel=1e-3)


def test_light_inside_the_window_bends_at_the_gel_only():
    # Straight above the source r -> 0: E = I / (n_w sum h / n)^2, and one interface to pass.
    depth_in_window = 2.0
    inside = Light((0.0, 0.0, -GEL_MM - depth_in_window), UP, (1.0, 1.0, 1.0))
    field = model(design(inside, window=PLATE)).light_field()
    n, m = 1.49, 1.41
    apparent = n * (depth_in_window / n + GEL_MM / m)
    passed = 1 - ((n - m) / (n + m)) ** 2
    assert field.irradiance()[15, 20, 0] == pytest.approx(passed / math.pi / apparent**2, rel=1e-3)
    # Of the gel's own index the window bends nothing.
    same = model(design(inside, window=replace(PLATE, refractive_index=m))).light_field()
    offset = same.points_mm.astype(np.float64) - inside.position_mm
    distance = np.linalg.norm(offset, axis=-1)
    expected = (offset[..., 2] / distance) ** 2 / math.pi / distance**2
    np.testing.assert_allclose(same.irradiance()[..., 0], expected, rtol=1e-3)


def test_area_light_converges_to_its_form_factor():
    # A Lambertian rectangle parallel to the face, seen from the point under its middle: four
    # quarters with a = w / h, b = l / h (Howell, "Catalog of radiation configuration factors",
    # C-5).
    width, length, height = 8.0, 4.0, 6.0
    light = Light((0.0, 0.0, -height), UP, (1.0, 1.0, 1.0), size_mm=(width, length))
    a, b = width / 2 / height, length / 2 / height
    quarter = (
        a / math.hypot(1, a) * math.atan(b / math.hypot(1, a))
        + b / math.hypot(1, b) * math.atan(a / math.hypot(1, b))
    ) / (2 * math.pi)
    expected = 4 * quarter / (width * length)
    errors = []
    for samples in (1, 8, 512):
        field = model(design(light), refraction=False, samples=samples).light_field()
        errors.append(abs(float(field.irradiance()[15, 20, 0]) / expected - 1))
    # A face larger than a quarter of its distance is cut into more cells than are asked for.
    assert max(errors) < 0.01
    assert errors[2] < 1e-3


def test_cells_of_area_lights_cover_them_evenly():
    light = Light((1.0, 2.0, -3.0), (1.0, 0.0, 0.0), (1.0, 2.0, 3.0), size_mm=(6.0, 2.0), lobe=3.0)
    samples = sample_lights((light,), 12)
    assert len(samples.positions_mm) == 12
    np.testing.assert_allclose(samples.positions_mm.mean(axis=0), light.position_mm)
    offsets = samples.positions_mm - light.position_mm
    # The width lies in the xy plane, across the axis.
    np.testing.assert_allclose(offsets[:, 0], 0.0, atol=1e-12)
    assert np.unique(np.round(offsets[:, 1], 6)).size == 6
    assert np.unique(np.round(offsets[:, 2], 6)).size == 2
    total = samples.intensities.sum(axis=0) * 2 * math.pi / (light.lobe + 1)
    np.testing.assert_allclose(total, light.rgb)


@pytest.mark.thorough
def test_a_step_throws_its_shadow():
    step, edge = 1.0, 1.0
    source_x, depth = 9.0, 6.0

    def stepped(xy):
        return -step * np.clip((xy[..., 0] - edge) / 0.05, 0.0, 1.0)

    way = np.array([-source_x, 0.0, depth]) / math.hypot(source_x, depth)
    light = Light((source_x, 0.0, -depth), tuple(way.tolist()), (1.0, 1.0, 1.0))
    options = {"refraction": False, "step_mm": 0.05, "half": 12.0, "size_px": (164, 124)}
    lit = model(design(light), stepped, **options).light_field()
    row = 62
    x = lit.points_mm[row, :, 0]
    value = lit.irradiance()[row, :, 0]
    # The upper end of the wall shades a strip whose far end the light passes just over.
    end = edge - step * (source_x - edge) / (depth - step)
    shaded = (x > end + 0.1) & (x < edge - 0.1)
    free = ((x < end - 0.1) & (x > -8)) | ((x > edge + 0.2) & (x < 6))
    assert shaded.sum() > 5
    np.testing.assert_allclose(value[shaded], 0.0)
    assert (value[free] > 0).all()
    assert lit.blocked[row][shaded] == pytest.approx(lit.facing[row][shaded])
    without = model(design(light), stepped, shadows=False, **options).light_field()
    assert (without.irradiance()[row, :, 0][shaded] > 0).all()


def two_lights() -> tuple[Light, Light]:
    return (
        Light((8.0, 0.0, -6.0), (-0.8, 0.0, 0.6), (1.0, 0.2, 0.0), size_mm=(3.0, 1.0)),
        Light((-6.0, 5.0, -8.0), (0.6, 0.0, 0.8), (0.0, 0.4, 1.0)),
    )


def test_light_adds_up_and_scales():
    first, second = two_lights()
    gloss = Coating((0.4, 0.5, 0.6), specular=0.3, roughness=0.4)

    def linear(*lights, ambient=0.0):
        optics = design(*lights, coating=gloss, window=PLATE, ambient_rgb=(ambient,) * 3)
        return model(optics).render().linear.astype(np.float64)

    both = linear(first, second)
    np.testing.assert_allclose(both, linear(first) + linear(second), rtol=1e-5, atol=1e-9)
    strong = replace(first, rgb=(3.0, 0.6, 0.0))
    np.testing.assert_allclose(
        linear(strong, ambient=0.5), 3 * linear(first, ambient=0.5), rtol=1e-5, atol=1e-9
    )
    # Ambient light is a share of the mean direct light.
    only_red = linear(first, ambient=0.5) - linear(first)
    assert only_red[..., 2].max() == 0.0
    assert only_red[..., 0].min() > 0.0


def test_renders_are_equal_to_the_bit():
    optics = design(*two_lights(), window=PLATE)
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
    gloss.weight = 1.0
    gloss.alpha2 = roughness**2
    reflected = []
    for cosine in (1.0, 0.7):
        total = wp.zeros(1, dtype=wp.float64, device="cpu")
        inputs = [gloss, cosine, 400, total]
        wp.launch(_glossy_albedo_kernel, dim=(400, 400), inputs=inputs, device="cpu")
        reflected.append(total.numpy()[0])
    # Facets steeper than 45 deg, a share of 1 - 1 / (1 + alpha^2), send light from straight above
    # below the horizon; masking takes a little more.
    most = 1 / (1 + gloss.alpha2)
    assert 0.85 * most < reflected[0] < most
    assert reflected[1] < 1


def test_markers_are_dark_round_and_where_they_belong():
    light = Light((0.0, 0.0, -20.0), UP, (1.0, 1.0, 1.0))
    grid = MarkerGrid(3, 3, 6.0, 5.0, 1.5, offset_mm=(0.5, -0.5))
    plain = model(design(light), refraction=False, size_px=(164, 124))
    dotted = model(design(light), refraction=False, size_px=(164, 124), markers=grid)
    image = dotted.render()
    ratio = image.linear[..., 1] / plain.render().linear[..., 1]
    xy = image.points_mm[..., :2]
    distance = np.linalg.norm(xy[:, :, None] - grid.points_mm(), axis=-1).min(axis=-1)
    soft = 30.0 / 240.0
    np.testing.assert_allclose(ratio[distance < 1.5 - soft], 0.05, rtol=1e-3)
    np.testing.assert_allclose(ratio[distance > 1.5 + soft], 1.0, rtol=1e-5)
    # Nine dots of pi r^2.
    area = (1 - ratio).sum() / 0.95 * soft**2
    assert area == pytest.approx(9 * math.pi * 1.5**2, rel=0.01)


def test_turbid_gel_over_black_skin_darkens_where_it_is_thin():
    # Kubelka and Munk: over black R = s / (s + 1); thick layers are white; none shows the skin.
    assert turbid_reflectance(np.array(0.0), np.array(2.0)) == pytest.approx(2 / 3)
    assert turbid_reflectance(np.array(0.3), np.array(0.0)) == pytest.approx(0.3)
    assert turbid_reflectance(np.array(0.3), np.array(1e6)) == pytest.approx(1.0)

    def dented(xy):
        return -1.5 * np.exp(-np.sum(xy**2, axis=-1) / 4.0)

    # From afar, so that the dent's middle is hardly nearer to the light.
    light = Light((0.0, 0.0, -400.0), UP, (1.0, 1.0, 1.0))
    black = Coating((0.02, 0.02, 0.02))
    turbid = model(design(light, coating=black, gel_scattering_per_mm=0.5), dented)
    image = turbid.render()
    field = turbid.light_field()
    s = 0.5 * (image.points_mm[15, 20, 2] + GEL_MM)
    assert turbid.reflectance(field)[15, 20, 0] == pytest.approx(
        (0.98 * s + 0.02) / (0.98 * s + 1), rel=1e-5
    )
    whole = model(design(light, coating=black, gel_scattering_per_mm=0.5)).render()
    assert image.linear[15, 20, 0] < 0.85 * whole.linear[15, 20, 0]


def test_other_formulas_keep_the_exposure():
    def lower(xy):
        return np.full(xy.shape[:-1], -1.0)

    optics = model(design(*two_lights(), window=PLATE))
    pressed = render_formula(optics, lower, (15.0, 15.0), 0.5)
    assert np.nanmax(pressed.points_mm[..., 2]) == pytest.approx(-1.0, abs=1e-5)
    alone = model(design(*two_lights(), window=PLATE), lower).render()
    np.testing.assert_allclose(pressed.linear, alone.linear, rtol=1e-5)
    assert (pressed.rgb != alone.rgb).any()
    np.testing.assert_array_equal(optics.render().rgb, optics.picture(optics.light_field()).rgb)


def test_exposure_puts_the_median_at_its_level():
    red, blue = two_lights()
    optics = design(red, replace(blue, rgb=(0.0, 0.1, 0.2)), window=PLATE)
    for balance in ("gray", "none"):
        image = model(optics, level=90.0, white_balance=balance).render()
        medians = np.median(image.rgb[image.mask], axis=0)
        assert medians.max() == pytest.approx(90, abs=1)
        if balance == "gray":
            np.testing.assert_allclose(medians, 90, atol=1)
        else:
            assert medians.min() < 80


def test_input_that_shows_nothing():
    light = Light((0.0, 0.0, -20.0), UP, (1.0, 1.0, 1.0))
    with pytest.raises(InputError, match="samples"):
        model(design(light), samples=0)
    with pytest.raises(InputError, match="size_px"):
        model(design(light), size_px=(1, 10))
    with pytest.raises(InputError, match="level"):
        model(design(light), level=300)
    with pytest.raises(InputError, match="gamma"):
        model(design(light), gamma=0.1)
    away = replace(light, direction=(0.0, 0.0, -1.0))
    with pytest.raises(InputError, match="no light reaches"):
        model(design(away))
    looking_back = design(
        light, camera=replace(design(light).camera, rotation=(1.0, 0.0, 0.0, 0.0))
    )
    with pytest.raises(InputError, match="sees the gel's contact face"):
        model(looking_back)
    with pytest.raises(InputError, match="no nodes to move"):
        model(design(light)).render(np.zeros((4, 3)))
    with pytest.raises(InputError, match="needs a mesh"):
        OpticalModel(design(light), None)
