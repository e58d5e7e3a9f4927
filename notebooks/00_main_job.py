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
# # The main job: from real captures to a sensor profile
#
# `taccel-lab demo` does this in one go on all captures; here the same steps run one by one on a
# part of them, so that everything can be looked at. The captures are GelSight ball presses from
# the PyPI package `taxim` (MIT).

# %%
import dataclasses
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from taccel_lab.warp_output import start_warp

start_warp()
plt.rcParams["figure.dpi"] = 60

from taccel_lab.calibration.capture import find_taxim_pack, load_captures

captures = load_captures(find_taxim_pack())
# Every third press: 12 to fit and 4 held out.
captures = dataclasses.replace(captures, presses=captures.presses[::3])
print(f"{len(captures.presses)} presses of a {captures.ball_radius_mm:g} mm ball")

figure, axes = plt.subplots(1, 3, figsize=(12, 3.2))
images = (captures.background, captures.presses[0].image(), captures.presses[9].image())
for axis, image, title in zip(axes, images, ("background", "a press", "another"), strict=True):
    axis.imshow(image)
    axis.set_title(title)
    axis.axis("off")

# %% [markdown]
# ## 1. Design the gel pad
#
# A sensor family of the catalogue has parameters with bounds and the source of each default. Its
# pad becomes a labelled tet mesh, in metres, and a first profile: pure data.

# %%
from taccel_lab.sensors.profile import catalogue_profile

base = catalogue_profile("gelsight")
for name, value in base.sensor.parameters.items():
    print(f"{name:>22} = {value}")
print(f"{base.mesh.node_count} nodes, {base.mesh.tet_count} tets")

# %% [markdown]
# ## 2. Find the contact circles
#
# A quarter of the presses is set aside first, by names and labels: nothing looks at these images
# before the colour model is frozen. For the others nobody clicks: the rim of each contact is found
# in the image and compared with the labels.

# %%
from taccel_lab.calibration.contacts.usable import usable_circles

split = captures.split(4)
usable = usable_circles(captures.only(split.train))
training, circles, agreement = usable.captures, usable.circles, usable.agreement
print(
    f"centres off by {agreement.center_median_px:.1f} px, radii by "
    f"{agreement.radius_median_px:.1f} px (median of {agreement.count})"
)

# %% [markdown]
# ## 3. Simulate every press
#
# A ball goes down on the finite-element gel until the simulated contact has the radius of the
# circle. How the gel sinks around the contact comes out of the simulation.

# %%
from taccel_lab.calibration.simulate import simulate_presses

surfaces = simulate_presses(training, circles, base, processes=2)
depth = [surface.depth_mm for surface in surfaces]
force = [surface.force_n for surface in surfaces]
print(f"depths {min(depth):.2f} to {max(depth):.2f} mm")
print(f"forces {min(force):.2f} to {max(force):.2f} N")
print(f"largest force residual {max(surface.residual_n for surface in surfaces):.1e} N")

row = round(circles[0].v_px)
x_mm = captures.grid.x_mm()
figure, axes = plt.subplots(1, 2, figsize=(12, 3.2))
axes[0].imshow(surfaces[0].displacement_mm(), cmap="viridis")
axes[0].set_title("displacement of the gel's surface")
axes[1].plot(x_mm, surfaces[0].height_m[row] * 1e3, label="pressed")
axes[1].plot(x_mm, surfaces[0].rest_height_m[row] * 1e3, "--", label="at rest")
axes[1].set_xlabel("x [mm]")
axes[1].set_ylabel("z [mm]")
legend = axes[1].legend()

# %% [markdown]
# ## 4. Fit the colour model
#
# Pixel position, surface normal and displacement to colour change, by a small network. Then the
# presses that were set aside are rendered where their labels put them; the bare background stands
# beside the figures, because whole-image figures flatter.

# %%
from taccel_lab.calibration.color.fit import fit_color
from taccel_lab.calibration.color.fit_options import ColorFitOptions
from taccel_lab.calibration.color.heldout import HeldoutSet


def simulated(presses, places):
    return simulate_presses(presses, places, base, processes=2)


result = fit_color(
    training,
    circles,
    surfaces,
    HeldoutSet.of(captures, split, simulated),
    options=ColorFitOptions(steps=800, batch_pixels=4096),
)
figures = result.figures()
for key in ("crop_psnr_db", "crop_ssim", "disc_l1"):
    print(
        f"{key:>13}: {figures['heldout'][key]:8.3f}   background only "
        f"{figures['background_only'][key]:8.3f}"
    )

item = result.heldout[0]
u, v, r = round(item.circle.u_px), round(item.circle.v_px), round(1.6 * item.circle.radius_px)
window = (slice(max(v - r, 0), v + r), slice(max(u - r, 0), u + r))
real, rendered = item.captured[window], item.placed["label"].shown[window]
figure, axes = plt.subplots(1, 3, figsize=(10, 3.2))
for axis, image, title in (
    (axes[0], real, "captured"),
    (axes[1], np.clip(rendered, 0, 255).astype(np.uint8), "rendered, never seen"),
    (axes[2], np.abs(rendered - real).mean(-1), "difference"),
):
    axis.imshow(image, **({"vmin": 0, "vmax": 30, "cmap": "magma"} if image.ndim == 2 else {}))
    axis.set_title(title)
    axis.axis("off")

# %% [markdown]
# ## 5. Export the profile and press it
#
# The profile is a folder: readable TOML, arrays with hashes, provenance of every block.

# %%
from taccel_lab.envs import PressPath, parse_indenter, simulate_press
from taccel_lab.profile import load_profile, save_profile
from taccel_lab.scene import Material
from taccel_lab.signals.color_model import ColorModel, ColorModelConfig

folder = Path(tempfile.mkdtemp()) / "profile"
save_profile(result.apply_to(base), folder)
profile = load_profile(folder)
print(sorted(path.name for path in folder.iterdir()))

# %%
from taccel_lab.sensors.press_mesh import press_mesh

at_mm = (1.0, -0.5)
outcome = simulate_press(
    press_mesh(profile.sensor.family, profile.sensor.parameters, at_mm, 1.2),
    Material(profile.material.young_modulus_pa, profile.material.poisson_ratio),
    parse_indenter("sphere:2.0"),
    at_mm,
    PressPath(depth_mm=0.8),
    profile.grid(),
    friction_coefficient=profile.material.friction_coefficient,
)
for step in outcome.steps:
    print(f"depth {step.depth_mm:.1f} mm  force {step.wrench[2]:.3f} N  {step.report.summary()}")
model = ColorModel(ColorModelConfig.from_dict(profile.color.architecture), profile.color_weights)
image = outcome.render(model, profile.background_rgb)
plt.figure(figsize=(6, 4))
plt.axis("off")
shown = plt.imshow(np.clip(image, 0, 255).astype(np.uint8))

# %%
assert all(step.report.converged.all() for step in outcome.steps)
assert outcome.smallest_volume_ratio > 0
assert figures["heldout"]["crop_psnr_db"] > figures["background_only"]["crop_psnr_db"] + 6
