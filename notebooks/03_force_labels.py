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
# # Force labels, and how wrong they are
#
# A force in a simulated data set has three errors: of the sum, of the mesh and of the model. This
# notebook measures the first two. The third, whether the gel's modulus and friction are those of
# your sensor, no simulation can tell: every force scales with the modulus.

# %%
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from taccel_lab import Outputs, PressEnv, SignalTactile, parse_indenter, profile_material
from taccel_lab.presses import PressSetup
from taccel_lab.presses.mesh import refined_press_mesh
from taccel_lab.sensors.profile import catalogue_profile
from taccel_lab.sensors.registry import profile_parameters

plt.rcParams["figure.dpi"] = 60

profile = catalogue_profile("flat_pad")
material = profile.material
print(
    f"flat pad {profile.gel.thickness_mm:g} mm thick, E {material.young_modulus_pa / 1e6:g} MPa,",
    end=" ",
)
print(f"nu {material.poisson_ratio:g}; both: {material.provenance.method}")


def press(tool, deepest_mm, friction=0.0):
    """The gel under a tool at its middle, meshed for a depth."""
    mesh = refined_press_mesh(profile_parameters(profile).pad(), (0, 0), tool.contact(deepest_mm))
    gel = profile_material(profile.material, mesh)
    return PressEnv(PressSetup(mesh, gel, tool, friction), np.zeros((1, 2)))


# %% [markdown]
# ## 1. One force, three ways
#
# A ball goes 0.4 mm down and 0.2 mm sideways. The label is the sum of the forces at the nodes. The
# tractions on the gel's face must add up to the same, by node and by pixel, and the gel is at rest
# when what pulls on each node is next to nothing.

# %%
ball = parse_indenter("sphere:4")
env = press(ball, 0.4, friction=0.5)
for depth_mm, shear_mm in ((0.2, 0), (0.4, 0), (0.4, 0.1), (0.4, 0.2)):
    report = env.move_to(depth_mm, (shear_mm, 0))

label = env.wrench[0, :3]
load = Outputs(env.solver).update(env.state).surface_load
by_traction = (load.areas.numpy()[..., None] * load.tractions.numpy())[0].sum(axis=0)
# Pixels of one size over the gel: those of the camera, which sees in perspective, show less of it
# the nearer it is.
grid = profile.grid()
sensor = SignalTactile.from_solver(env.solver, grid)
sensor.update(env.state)
traction, normals, contact = (
    array.numpy()[0] for array in sensor.read("traction_pa", "normals", "contact")
)
pixel_m2 = 1e-6 * grid.mm_per_px_x * grid.mm_per_px_y
shown = np.isfinite(normals[..., 2])
by_pixel = (traction[shown] * pixel_m2 / normals[shown][:, 2:]).sum(axis=0)
for name, force in (
    ("label (wrench on the ball)", label),
    ("tractions, by node", -by_traction),
    ("tractions, by pixel", -by_pixel),
):
    off = np.linalg.norm(force - label) / np.linalg.norm(label)
    print(f"{name:<27} {force.round(4)} N   off by {off:.1e}")
print(f"largest pull left on the gel: {report.residual_n[0]:.1e} N")

# %%
figure, axes = plt.subplots(1, 3, figsize=(13, 3.4))
for axis, field, title in zip(
    axes,
    (-traction[..., 2] / 1e3, np.hypot(traction[..., 0], traction[..., 1]) / 1e3, contact),
    ("pressure [kPa]", "friction [kPa]", "contact"),
    strict=True,
):
    drawn = axis.imshow(field[80:240, 80:240])
    axis.set_title(title)
    axis.axis("off")
    figure.colorbar(drawn, ax=axis)

# %% [markdown]
# ## 2. Against closed forms
#
# Without friction the force on a glued flat layer is known exactly for small strains (Lebedev and
# Ufliand 1958). Hertz's formula is its limit for infinite thickness. This gel is as
# thick as the ball's radius.

# %%
from taccel_lab.presses.bonded_layer import layer_force_n

E, nu, thickness_mm = material.young_modulus_pa, material.poisson_ratio, profile.gel.thickness_mm
depths_mm = np.array([0.1, 0.2, 0.4, 0.8])
simulated, estimated = [], []
for depth_mm in depths_mm:
    env = press(ball, depth_mm)
    env.move_to(depth_mm)
    simulated.append(env.press_force[0, 2])
    estimated.append(env.error_estimate().force_n[0])
simulated, estimated = np.array(simulated), np.array(estimated)
layer = layer_force_n("sphere", depths_mm, 4.0, thickness_mm, nu, E)
hertz = 4 / 3 * E / (1 - nu**2) * np.sqrt(4e-3) * (1e-3 * depths_mm) ** 1.5
print("depth [mm]  simulated [N]  estimated error  over the layer's  Hertz over the layer's")
for row in zip(
    depths_mm, simulated, estimated / simulated, simulated / layer, hertz / layer, strict=True
):
    print("{:10.1f} {:14.4f} {:15.1%} {:17.3f} {:23.3f}".format(*row))
too_high = layer / hertz - 1
print(f"a modulus by Hertz is too high by {too_high[0]:.0%} to {too_high[-1]:.0%}")

# %% [markdown]
# The simulation is within its own stated error of the layer's formula. Hertz is not: a modulus
# fitted by Hertz to real presses of this gel would be too high by what stands in the last line.

# %%
figure, axis = plt.subplots(figsize=(7, 3.6))
axis.errorbar(
    depths_mm, simulated / layer, estimated / layer, fmt="o-", capsize=4, label="simulated"
)
axis.plot(depths_mm, hertz / layer, "s--", label="Hertz")
axis.axhline(1, color="k", lw=0.8, label="bonded layer, exact for small strains")
axis.set(xlabel="depth [mm]", ylabel="force over the layer's")
legend = axis.legend()

# %% [markdown]
# ## 3. What a data set says of its own error
#
# Every row of a data set carries `force_error_n`, what 19 of 20 presses of its grade keep to. Here
# it is run twice to see: a data set by the accuracy `fast`, and the same touches with finer meshes.
# `fast` is off by the difference.

# %%
from taccel_lab.datasets.plan import DatasetPlan
from taccel_lab.datasets.reading import Dataset
from taccel_lab.datasets.runner import make_dataset
from taccel_lab.datasets.spec import load_spec
from taccel_lab.presses import PHYSICS, Accuracy

folder = Path(tempfile.mkdtemp())
text = """
[dataset]
name = "balls and a punch"
episodes = 6
seed = 3
accuracy = "fast"
view = 0.4

[[sensors]]
profile = "flat_pad"

[[objects]]
tool = "sphere:2"

[[objects]]
tool = "sphere:5"

[[objects]]
tool = "cylinder:2"

[[motions]]
kind = "press"
depth_mm = [0.2, 0.5]
step_mm = 0.25

[output]
channels = ["patch_forces_n"]
size_px = [64, 64]
"""
(folder / "touches.toml").write_text(text)
spec = load_spec(folder / "touches.toml")
for name, physics in (("fast", None), ("finer", PHYSICS[Accuracy.DEFAULT])):
    made = make_dataset(DatasetPlan(spec, folder, physics), folder / name, source=text, processes=0)
    print(f"{name}: {made.steps} rows in {made.seconds:.0f} s")

fast, finer = Dataset(folder / "fast"), Dataset(folder / "finer")
assert (fast.steps["episode"] == finer.steps["episode"]).all()
pressed = fast.steps["step"] > 0
force_n, stated_n = (fast.steps[name][pressed] for name in ("force_z_n", "force_error_n"))
finer_n, finer_stated_n = (finer.steps[name][pressed] for name in ("force_z_n", "force_error_n"))
tools = [fast.episodes[episode]["object"] for episode in fast.steps["episode"][pressed]]
off_n = force_n - finer_n
print("tool        fast [N]  stated +- [N]  off by [N]   finer [N]  stated +- [N]")
for row in zip(tools, force_n, stated_n, off_n, finer_n, finer_stated_n, strict=True):
    print("{:<10} {:9.4f} {:14.4f} {:+11.4f} {:11.4f} {:14.4f}".format(*row))
within = np.abs(off_n) <= stated_n + finer_stated_n
print(f"{within.sum()} of {len(within)} within what both state together")

# %%
figure, axis = plt.subplots(figsize=(6, 4.4))
for tool in dict.fromkeys(tools):
    of_tool = np.array([other == tool for other in tools])
    axis.loglog(stated_n[of_tool], np.abs(off_n[of_tool]), "o", label=tool)
ends = [stated_n.min() / 2, stated_n.max() * 2]
axis.plot(ends, ends, "k", lw=0.8)
axis.set(xlabel="error that `fast` states [N]", ylabel="difference from finer meshes [N]")
legend = axis.legend()

# %% [markdown]
# Below the line the label keeps its word. A network that learns from such labels can weigh them by
# `force_error_n`; `taccel-lab calibrate force` reports it beside its own error.
#
# The label is on the scale of the assumed modulus. One measured press puts that right for all of
# them ([material](../docs/calibration_material.md)).

# %%
assert np.allclose(by_traction, -label, rtol=1e-9)
assert np.linalg.norm(by_pixel + label) < 0.01 * np.linalg.norm(label)
assert np.abs(simulated / layer - 1).max() < 0.03
assert (hertz < layer).all() and hertz[-1] < 0.65 * layer[-1]
assert within.mean() >= 0.9
