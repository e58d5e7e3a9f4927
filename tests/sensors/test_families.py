# SPDX-License-Identifier: Apache-2.0
"""Every family at its nominal and at random parameters: sources, formulas, meshes, presses."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.cad.mesh.gel_mesh import FocusOptions, focused_gel_mesh, gel_mesh, usual_edge_mm
from taccel_lab.cad.mesh.quality import measure_quality, require_quality
from taccel_lab.cad.mesh.tetrahedralize import tetwild_gel_mesh
from taccel_lab.cad.parameters import Parameter
from taccel_lab.cad.parts.pad import Pad
from taccel_lab.cad.parts.pad_solid import labelled_solid
from taccel_lab.errors import InputError
from taccel_lab.presses import PressEnv, PressSetup, layered_material, parse_indenter
from taccel_lab.profile import load_profile, save_profile
from taccel_lab.scene import Material
from taccel_lab.sensors import FamilyParameters, SensorFamily, profile, sensor_families
from taccel_lab.sensors.base import STIFFNESS
from taccel_lab.sensors.derived import derived_figures
from taccel_lab.sensors.profile import catalogue_profile
from tests.support.variants import variants

FAMILIES = sensor_families()
each_family = pytest.mark.parametrize("family", FAMILIES.values(), ids=FAMILIES)
LATER = (
    "camera_x_mm", "camera_y_mm", "camera_tilt_x_deg", "camera_tilt_y_deg", "led_power",
    "led_turn_deg", "led_arc_deg", "led_half_angle_deg",
)  # fmt: skip
"""Parameters that draw from further generators: seeds deal the others what they always did."""


def random_value(spec: Parameter, rng: np.random.Generator) -> Any:
    """A value inside the bounds; one in four is the zero that means something."""
    if spec.choices:
        return str(rng.choice(spec.choices))
    if spec.zero_means and rng.random() < 0.25:
        return 0
    low, high = float(spec.minimum or 0.0), float(spec.maximum or 0.0)
    if spec.each == "camera":
        # Bounds are those of the largest gels: others are seen from nearer to their middle.
        low, high = low / 6, high / 6
    if low > 0 and high / low > 30:
        value = math.exp(rng.uniform(math.log(low), math.log(high)))
    else:
        value = rng.uniform(low, high)
    value = min(max(value, low), high)
    return round(value) if isinstance(spec.default, int) else value


def value_near_default(spec: Parameter, rng: np.random.Generator, share: float) -> Any:
    """The default changed by up to ``share`` of itself, inside the bounds; choices stay."""
    if spec.choices or isinstance(spec.default, tuple) or (spec.zero_means and not spec.default):
        return spec.default
    value = spec.default * (1 + share * rng.uniform(-1, 1))
    value = min(max(value, float(spec.minimum or 0.0)), float(spec.maximum or 0.0))
    return round(value) if isinstance(spec.default, int) else value


def random_parameters(
    family: SensorFamily, rng: np.random.Generator, near: float | None = None
) -> FamilyParameters | InputError:
    """Parameters drawn inside their bounds, or why the family refuses the combination.

    With ``near`` they differ from the defaults by up to that share.
    """
    specs = family.parameters_type.parameters()

    def drawn(name: str, rng: np.random.Generator) -> Any:
        spec = specs[name]
        return random_value(spec, rng) if near is None else value_near_default(spec, rng, near)

    draw = {name: drawn(name, rng) for name in specs if name not in LATER}
    stiffness = rng.choice(STIFFNESS)
    draw |= {name: drawn(name, rng.spawn(1)[0]) for name in LATER}
    draw = {name: value for name, value in draw.items() if name not in {*STIFFNESS} - {stiffness}}
    try:
        return family.parameters(draw)
    except InputError as error:
        return error


def accepted(family: SensorFamily, seed: int, near: float | None = None) -> FamilyParameters:
    """The first random parameters of a seed that the family accepts."""
    rng = np.random.default_rng(seed)
    for _ in range(40):
        found = random_parameters(family, rng, near)
        if not isinstance(found, InputError):
            return found
    raise AssertionError(f"{family.name} refused 40 random sets of parameters")


def assert_pressed(parameters: FamilyParameters) -> None:
    """A ball pressed twice as deep pushes back harder, straight up; on a small focused mesh."""
    pad = parameters.pad()
    radius = 0.12 * float(np.ptp(pad.bounds_mm(), axis=0)[:2].min())
    depth = min(0.05 * pad.thickness_mm, 0.1 * radius)
    focus = FocusOptions((0.0, 0.0), 0.6 * radius, 0.15 * radius, core=4, rings=6, layers=2)
    mesh = focused_gel_mesh(pad, focus)
    layers = [
        Material(m.young_modulus_pa, m.poisson_ratio, m.density_kg_m3)
        for m in parameters.layer_materials()
    ]
    material, ball = layered_material(layers, mesh), parse_indenter(f"sphere:{radius}")
    friction = parameters.material().friction_coefficient
    env = PressEnv(
        PressSetup(mesh, material, ball, friction_coefficient=friction), np.zeros((1, 2))
    )
    forces = []
    for part in (0.5, 1.0):
        assert env.move_to(part * depth).converged.all()
        forces.append(env.wrench[0, :3].copy())
    assert 0 < 1.5 * forces[0][2] < forces[1][2]
    assert np.abs(forces[1][:2]).max() < 0.15 * forces[1][2]


@each_family
def test_every_default_has_a_source_and_lies_inside_its_bounds(family: SensorFamily) -> None:
    assert family.title and family.references
    specs = family.parameters_type.parameters()
    units = {"_mm": "mm", "_px": "px", "_deg": "deg", "_mpa": "MPa"}
    for name, spec in specs.items():
        assert len(spec.source) >= 10, name
        assert spec.description, name
        assert spec.check(spec.default) == spec.default
        for suffix, unit in units.items():
            if name.endswith(suffix):
                assert spec.unit in (unit, "mm/px", "1/mm"), name
        # One step out of bounds is refused by name.
        outside = [] if spec.minimum is None else [spec.minimum - 1e-3 * abs(spec.minimum) - 1]
        outside += [] if spec.maximum is None else [spec.maximum * 1.001 + 1]
        for value in outside:
            if not (spec.zero_means and value == 0):
                with pytest.raises(InputError, match=f"{name} = "):
                    family.parameters({name: value})
    # A family that takes over a default takes over its source with it, never a bare number.
    assert sum("no source states it" not in spec.source for spec in specs.values()) > 25


@pytest.mark.thorough(cases=("digit", "gelsight", "gelsight_40", "gelsight_r15"))
@settings(max_examples=6)
@given(seed=st.integers(0, 2**32 - 1))
@pytest.mark.parametrize("name", FAMILIES)
def test_random_parameters_build_or_say_which_bound_they_break(name: str, seed: int) -> None:
    family = FAMILIES[name]
    found = random_parameters(family, np.random.default_rng(seed))
    if isinstance(found, InputError):
        assert str(found).startswith(f"sensor {name}: ")
        named = [*family.parameters_type.parameters(), "crown", "pocket"]
        assert any(word in str(found) for word in named), str(found)
        return
    pad, grid = found.pad(), found.grid()
    low, high = pad.bounds_mm()
    assert (high > low).all() and high[2] <= 0.05
    assert pad.thickness_mm > 0
    box = float((high - low).prod())
    # A pad that is its box is so to rounding.
    assert 0.02 * box < pad.volume_mm3() <= box * (1 + 1e-12)
    assert len(found.layer_materials()) == len(pad.layer_names)
    design, markers = found.optics(), found.markers()
    assert design is not None and len(design.lights) == (found.values()["led_count"] or 1)
    assert (design.camera.width_px, design.camera.height_px) == (grid.width_px, grid.height_px)
    if markers is not None:
        assert np.isfinite(pad.top_mm(markers.points_mm())).all()
    assert all(np.isfinite(v) for v, _ in derived_figures(found).values() if isinstance(v, float))


@pytest.mark.thorough(cases=("digit", "flat_pad", "gelsight", "gelsight_r15", "gelsight_wedge"))
@each_family
def test_bounds_leave_room_for_one_another(family: SensorFamily) -> None:
    rng = np.random.default_rng(11)
    refused = [isinstance(random_parameters(family, rng), InputError) for _ in range(60)]
    assert np.mean(refused) < 0.6


@pytest.mark.thorough(
    cases=("9dtact", "digit", "digit_360", "flat_pad", "gelsight_40", "gelsight_mini",
           "gelsight_r15", "gelsight_wedge")
)  # fmt: skip
@each_family
def test_nominal_sensor_is_meshed(family: SensorFamily) -> None:
    """By the usual edge; profiles of this process take the same mesh."""
    parameters = family.parameters()
    pad = parameters.pad()
    mesh, quality, edge_mm = profile.sound_gel_mesh(pad)
    assert edge_mm == usual_edge_mm(pad) and quality.min_dihedral_deg >= 10.0
    require_quality(mesh, quality)
    assert mesh.volumes_m3().sum() * 1e9 == pytest.approx(pad.volume_mm3(), rel=5e-3)
    assert set(np.unique(mesh.tet_layers)) == set(range(len(parameters.layer_materials())))


PRESSED = [("digit", None), ("digit_360", None), ("rtac", None)]


@pytest.mark.thorough
@pytest.mark.parametrize(("name", "seed"), variants(PRESSED, FAMILIES, [None, 0, 1, 2]))
def test_nominal_and_random_sensors_are_pressed(name: str, seed: int | None) -> None:
    family = FAMILIES[name]
    assert_pressed(family.parameters() if seed is None else accepted(family, seed))


@pytest.mark.slow
@each_family
def test_similar_sensors_are_meshed(family: SensorFamily) -> None:
    """Within 15 % of the defaults. The structured mesher may miss the gate by a few degrees at
    tight corners; then the free-form one passes it."""
    refused: list[Pad] = []
    for seed in range(4):
        pad = accepted(family, seed, near=0.15).pad()
        mesh = gel_mesh(pad)
        quality = measure_quality(mesh, pad)
        try:
            require_quality(mesh, quality)
            assert quality.min_dihedral_deg >= 10.0
        except InputError as error:
            assert "dihedral" in str(error)
            refused.append(pad)
    assert len(refused) <= 2
    for pad in refused[:1]:
        assert measure_quality(tetwild_gel_mesh(pad), pad).min_dihedral_deg >= 10.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
@each_family
def test_random_sensor_is_built_in_cad(family: SensorFamily, seed: int) -> None:
    pad = accepted(family, seed).pad()
    try:
        part = labelled_solid(pad)
    except InputError as error:
        assert "the CAD kernel" in str(error) and "rim_mm" in str(error)
        return
    assert part.solid.is_valid
    assert part.solid.volume == pytest.approx(pad.volume_mm3(), rel=5e-3)


@pytest.mark.thorough(cases=("9dtact",))
@pytest.mark.parametrize("name", ["9dtact", "gelsight_mini", "rtac"])
def test_designed_profiles_come_back(name: str, tmp_path: Path) -> None:
    designed, parameters = catalogue_profile(name), FAMILIES[name].parameters()
    save_profile(designed, tmp_path / "profile")
    loaded = load_profile(tmp_path / "profile")
    assert loaded.blocks() == designed.blocks()
    assert loaded.optical_design() == parameters.optics()
    assert np.array_equal(loaded.mesh.tet_layers, designed.mesh.tet_layers)
    assert (loaded.markers.grid() if loaded.markers else None) == parameters.markers()
    housing = parameters.housing()
    assert loaded.housing is not None and housing is not None
    assert loaded.housing.size_mm == housing.size_mm
    assert "housing_x_mm" in loaded.housing.provenance.source
    layers = [m.young_modulus_pa for m in parameters.layer_materials()[1:]]
    assert [layer.young_modulus_pa for layer in loaded.material.layers] == layers
    assert loaded.grid() == parameters.grid()


@pytest.mark.thorough
def test_published_blocks_hold_published_figures_alone() -> None:
    for name in FAMILIES:
        for block in catalogue_profile(name).blocks().values():
            if block.provenance.kind == "published":
                source = block.provenance.source
                assert "assumption" not in source and ": fit: " not in source, (name, block.key)
    # The modulus was identified here, the lamps were searched for: nobody has published either.
    mini = catalogue_profile("gelsight_mini").blocks()
    kinds = [mini[key].provenance.kind for key in ("material", "lights", "camera")]
    assert kinds == ["assumed", "assumed", "published"]
