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
# `taccel-lab demo` does this in one go on all captures; here the same calls run one by one on a
# part of them, so that everything can be looked at. The captures are GelSight ball presses from
# the PyPI package `taxim` (MIT).

# %%
import dataclasses
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import taccel_lab as tl
from taccel_lab.calibration.capture import find_taxim_pack
from taccel_lab.calibration.capture.load import load_capture_folder

plt.rcParams["figure.dpi"] = 60

folder = load_capture_folder(find_taxim_pack())
# Every third press: 12 to fit and 4 held out.
folder = dataclasses.replace(folder, presses=folder.presses[::3])
captures = folder.ball_presses()
print(f"{len(captures.presses)} presses of a {captures.ball_radius_mm:g} mm ball")

figure, axes = plt.subplots(1, 3, figsize=(12, 3.2))
images = (captures.background, captures.presses[0].image(), captures.presses[9].image())
for axis, image, title in zip(axes, images, ("background", "a press", "another"), strict=True):
    axis.imshow(image)
    axis.set_title(title)
    axis.axis("off")

# %% [markdown]
# ## 1. The design
#
# A sensor family of the catalogue has parameters with bounds and the source of each default. Its
# pad becomes a labelled tet mesh, in metres, and a first profile: pure data.

# %%
tl.load_sensor("gelsight")

# %% [markdown]
# ## 2. Calibrate
#
# A quarter of the presses is set aside first, by names and labels: nothing looks at these images
# before the colour model is frozen. The rim of each contact is found in the image, each press is
# simulated until its contact has that radius, and a small network learns colour from slope.

# %%
calibration = tl.calibrate(folder, only=("background", "color"))
calibration

# %% [markdown]
# The score is that of the presses set aside; the untouched image stands beside it, because figures
# over a whole image flatter.

# %%
score = calibration.color.score
bare = calibration.color.figures()["background_only"]
print(f"{score.psnr_db:.1f} dB in the crop, the untouched image {bare['crop_psnr_db']:.1f} dB")
print(f"{score.disc_l1:.2f} levels in the contact, the untouched image {bare['disc_l1']:.1f}")

item = calibration.color.heldout[0]
u, v, r = round(item.circle.u_px), round(item.circle.v_px), round(1.6 * item.circle.radius_px)
window = (slice(max(v - r, 0), v + r), slice(max(u - r, 0), u + r))
real, rendered = item.captured[window], item.shown[window]
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
# ## 3. Save the profile and press it
#
# The profile is a folder: readable TOML, arrays with hashes, provenance of every block. The press
# is at a place where no capture was taken.

# %%
place = Path(tempfile.mkdtemp()) / "profile"
calibration.save(place)
print(sorted(path.name for path in place.iterdir()))
press = tl.press(place, "sphere:2.0", depth_mm=0.8, at_mm=(1.0, -0.5))
press

# %%
press.plot()

# %%
assert press.smallest_volume_ratio > 0
assert press.image.shape == captures.background.shape
assert score.psnr_db > bare["crop_psnr_db"] + 6
