# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Design a sensor: how thick, how round?
#
# What a thinner, thicker or flatter gel would do to the picture that a DIGIT takes, at equal load:
# a robot pushes with a force and not to a depth. On the way the gel is built, meshed and seen
# through its camera, and at the end a workshop gets its files.

# %%
import tempfile
import warnings
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from IPython.display import SVG, display

from taccel_lab.sensors.registry import sensor_family

warnings.filterwarnings("ignore", message="IProgress")  # of widgets that are not needed
plt.rcParams["figure.dpi"] = 60

family = sensor_family("digit")
described = family.parameters().describe()
for name in ("width_mm", "length_mm", "thickness_mm", "mid_radius_mm", "young_modulus_mpa"):
    one = described[name]
    allowed = f"{one['minimum']:g} to {one['maximum']:g} {one['unit']}"
    print(f"{name:>18} = {one['value']:<5g} {allowed:<15} {one['source'][:70]}")

# %% [markdown]
# Each parameter has bounds, and each default says where it is from. What is out of them is rejected
# with what is allowed:

# %%
from taccel_lab import InputError

try:
    family.parameters({"mid_radius_mm": 5})
except InputError as error:
    print(error)

# %% [markdown]
# ## 1. Solid and mesh
#
# The solid is exact. The mesh is not: chords cut off what is round, and the fillet along the wall
# squeezes large tets flat. Every mesh passes a gate before anything is simulated on it. The gate
# says which limit is broken, by how much and where.

# %%
from taccel_lab.cad.mesh.gel_mesh import gel_mesh
from taccel_lab.cad.mesh.quality import QualityGate, check_quality, measure_quality
from taccel_lab.cad.mesh.tessellate import tessellate_solid
from taccel_lab.cad.parts.pad_solid import labelled_solid

pad = family.parameters().pad()
solid = labelled_solid(pad)
surface = tessellate_solid(solid)
print(f"solid: {solid.volume_mm3:.1f} mm3")
passed = {}
for edge_mm in (2.0, 1.0):
    mesh = gel_mesh(pad, edge_mm)
    quality = measure_quality(mesh, pad, cad_volume_mm3=solid.volume_mm3, cad_surface=surface)
    gate = check_quality(mesh, quality, QualityGate().at_edge(edge_mm))
    passed[edge_mm] = gate.passed
    print(
        f"edge {edge_mm:g} mm: {quality.node_count} nodes, {quality.tet_count} tets, "
        f"smallest angle {quality.min_dihedral_deg:.1f} deg, volume "
        f"{quality.volume_error_percent:+.2f} %, off the solid by {1e3 * quality.hausdorff_mm:.0f}"
        f" um at most\n   {'; '.join(v.text for v in gate.violations) or 'passes the gate'}"
    )

# %%
from PIL import Image

from taccel_lab.cad.preview import write_preview

folder = Path(tempfile.mkdtemp())
write_preview(mesh, folder / "mesh.png", title="DIGIT, edges of 1 mm")
display(Image.open(folder / "mesh.png").convert("RGB").reduce(2).quantize(64))

# %% [markdown]
# ## 2. Press to a load
#
# A ball of 3 mm radius pushes with 1 N on gels of three thicknesses. How deep it goes is not known
# before. The first guess is the exact linear solution of a flat layer that is glued to a rigid
# base (Lebedev and Ufliand); then a few steps of the simulation correct it.
#
# Hertz's formula knows no thickness: it is that of an infinitely thick gel.

# %%
from scipy.optimize import brentq

from taccel_lab import OpticalModel, PressEnv, SignalTactile, parse_indenter, profile_material
from taccel_lab.presses import PHYSICS, Accuracy, PressSetup
from taccel_lab.presses.bonded_layer import layer_force_n
from taccel_lab.presses.mesh import refined_press_mesh
from taccel_lab.sensors.profile import catalogue_profile
from taccel_lab.sensors.registry import profile_parameters

physics = PHYSICS[Accuracy.FAST]


def press_to(load_n, tool, guess_mm, profile):
    """A press that ends at a load, to 1 %."""
    pad = profile_parameters(profile).pad()
    mesh = refined_press_mesh(pad, (0, 0), tool.contact(guess_mm), physics.mesh)
    material = profile_material(profile.material, mesh)
    env = PressEnv(PressSetup(mesh, material, tool, physics=physics), np.zeros((1, 2)))
    depth_mm = guess_mm
    for _ in range(8):
        env.move_to(depth_mm)
        force_n = env.press_force[0, 2]
        if abs(force_n / load_n - 1) < 0.01:
            return env, depth_mm
        depth_mm *= (load_n / force_n) ** (2 / 3)
    raise AssertionError(f"{load_n} N not reached: {force_n} N at {depth_mm} mm")


def look(env, profile):
    """Camera pictures at rest and pressed, and the contact's area [mm2] and pressure [Pa]."""
    camera = OpticalModel(profile.optical_design(), env.mesh, size_px=(180, 240))
    shapes = env.mesh.nodes_m, env.positions[0]
    pictures = [camera.render(nodes_m).rgb.astype(float) for nodes_m in shapes]
    sensor = SignalTactile.from_profile(profile, solver=env.solver)
    sensor.update(env.state)
    contact, pressure = (array.numpy()[0] for array in sensor.read("contact", "pressure_pa"))
    grid = profile.grid()
    return pictures, contact.sum() * grid.mm_per_px_x * grid.mm_per_px_y, pressure


RADIUS_MM, LOAD_N = 3.0, 1.0
ball = parse_indenter(f"sphere:{RADIUS_MM:g}")
base = catalogue_profile("digit")
young, nu = base.material.young_modulus_pa, base.material.poisson_ratio
hertz_mm = 1e3 * (0.75 * LOAD_N * (1 - nu**2) / young / np.sqrt(1e-3 * RADIUS_MM)) ** (2 / 3)
print(f"E {young / 1e6:g} MPa, nu {nu:g}; Hertz: {hertz_mm:.3f} mm whatever the gel")

thin = {}
for thickness_mm in (2.0, 4.07, 8.0):
    profile = catalogue_profile("digit", {"thickness_mm": thickness_mm})
    layer_mm = brentq(
        lambda d, h: float(layer_force_n("sphere", d, RADIUS_MM, h, nu, young)) - LOAD_N,
        0.01, 2.0, args=(thickness_mm,),
    )  # fmt: skip
    env, depth_mm = press_to(LOAD_N, ball, layer_mm, profile)
    pictures, area_mm2, _ = look(env, profile)
    thin[thickness_mm] = depth_mm, layer_mm, pictures, area_mm2
    print(
        f"{thickness_mm:5.2f} mm of gel: {depth_mm:.3f} mm deep (flat layer {layer_mm:.3f}), "
        f"contact {area_mm2:.2f} mm2"
    )

# %% [markdown]
# A thin gel is stiffer than Hertz says, and its contact smaller. Even 8 mm, more than four times
# the contact's radius, are not thick enough for Hertz. What the round face and large strains add is
# the rest of the difference to the flat layer.

# %%
figure, axes = plt.subplots(1, 4, figsize=(13, 3.6))
figure.suptitle(f"ball of {RADIUS_MM:g} mm, {LOAD_N:g} N", y=1.02)
rest = thin[4.07][2][0]
axes[0].imshow(rest.astype(np.uint8))
axes[0].set_title("untouched, 4.07 mm")
for axis, (thickness_mm, (_, _, (before, after), area_mm2)) in zip(
    axes[1:], thin.items(), strict=True
):
    axis.imshow(np.clip(128 + 2 * (after - before), 0, 255).astype(np.uint8))
    axis.set_title(f"{thickness_mm:g} mm: change x 2, {area_mm2:.1f} mm2")
for axis in axes:
    axis.axis("off")

# %% [markdown]
# The pictures are predicted by the optical model: the camera's exposure is set on the untouched
# gel, and shadows and refraction are in them. Colours of a real unit need captures
# ([the main job](00_main_job.ipynb)).
#
# ## 3. How round should it be?
#
# A ball of 15 mm radius, nearly flat to such a gel, with 2 N. Across the finger the curvatures of
# ball and gel add up, along it there is the ball's alone: the contact is an oval.

# %%
BALL_MM, PUSH_N = 15.0, 2.0
large = parse_indenter(f"sphere:{BALL_MM:g}")
round_gels = {}
for radius_mm, guess_mm in ((0, 0.55), (21.4, 0.63)):
    profile = catalogue_profile("digit", {"mid_radius_mm": radius_mm})
    env, depth_mm = press_to(PUSH_N, large, guess_mm, profile)
    pictures, area_mm2, pressure = look(env, profile)
    # Spread of the pressed pixels along the finger over that across it.
    rows, columns = np.nonzero(pressure > 0.1 * pressure.max())
    oval = rows.std() / columns.std()
    round_gels[radius_mm] = depth_mm, pictures, area_mm2, pressure, oval
    print(
        f"{f'radius {radius_mm:g} mm' if radius_mm else 'flat':>15}: {depth_mm:.3f} mm deep, "
        f"contact {area_mm2:4.1f} mm2, {oval:.2f} times as long as wide, "
        f"{pressure.max() / 1e3:.0f} kPa in the middle"
    )

# %%
figure, axes = plt.subplots(1, 4, figsize=(12, 3.6), width_ratios=[1, 1.25] * 2)
for k, (radius_mm, (_, (before, after), _, pressure, _)) in enumerate(round_gels.items()):
    axes[2 * k].imshow(np.clip(128 + 4 * (after - before), 0, 255).astype(np.uint8))
    axes[2 * k].set_title(f"{f'R {radius_mm:g} mm' if radius_mm else 'flat'}, change x 4")
    shown = axes[2 * k + 1].imshow(pressure / 1e3, vmin=0, vmax=120, cmap="viridis")
    axes[2 * k + 1].set_title("kPa")
    figure.colorbar(shown, ax=axes[2 * k + 1], shrink=0.8)
for axis in axes:
    axis.axis("off")

# %% [markdown]
# So the sensor's own shape is in every picture: who reads an object's curvature from it must take
# the gel's off. And a round gel presses harder in the middle: less area under the same load.
#
# ## 4. What the workshop gets
#
# `design_sensor` writes a folder whole or not at all. `parts` may also name the moulds and the
# assembly, which take longer.

# %%
from taccel_lab.sensors.design import design_sensor

made = design_sensor(family, {"mid_radius_mm": 40}, folder / "flatter", parts=("drawing",))
for kind, path in sorted(made.files.items()):
    size = f"{path.stat().st_size / 1e3:6.0f} kB" if path.is_file() else "   folder"
    print(f"{kind:>12} {size}  {path.name}")
display(SVG(made.files["drawing"]))

# %%
depths = [thin[h][0] for h in sorted(thin)]
assert not passed[2.0] and passed[1.0]
assert depths == sorted(depths) and depths[-1] < hertz_mm
assert all(abs(depth / layer - 1) < 0.15 for depth, layer, *_ in thin.values())
(flat_area, flat_oval), (round_area, round_oval) = (
    (found[2], found[4]) for found in round_gels.values()
)
assert round_area < flat_area and abs(flat_oval - 1) < 0.05 and round_oval > 1.1
assert all(made.files[kind].exists() for kind in ("mesh", "drawing", "profile"))
