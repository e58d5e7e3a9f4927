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
# # A profile in torch: many sensors, and gradients
#
# A calibrated profile becomes a batch of sensors in torch: images, markers, wrenches, gradients.
# These say how deep each tool must go for a force; a finer press says what the coarse gel of the
# batch was worth.
#
# ## 1. A profile with colours
#
# [The main job](00_main_job.ipynb) says what each step is and scores it on presses that it never
# saw. Here the same in a hurry, on two ball presses of the PyPI package `taxim` (MIT), without a
# score: enough for images that look like the sensor's, and for nothing else.

# %%
import dataclasses
import time

import matplotlib.pyplot as plt
import numpy as np
import torch

from taccel_lab.calibration.capture import find_taxim_pack, load_captures
from taccel_lab.calibration.circles.ball_surface import layer_of, layer_surfaces
from taccel_lab.calibration.circles.usable import usable_circles
from taccel_lab.calibration.color.fit import fit_color
from taccel_lab.calibration.press_options import ColorFitOptions
from taccel_lab.sensors.profile import catalogue_profile
from taccel_lab.signals.rest_surface import rest_surface

plt.rcParams["figure.dpi"] = 60

captures = load_captures(find_taxim_pack())
captures = dataclasses.replace(captures, presses=captures.presses[:20:10])
base = catalogue_profile("gelsight")
usable = usable_circles(captures)
rest = rest_surface(base.mesh, captures.grid)
surfaces = layer_surfaces(usable.captures, usable.circles, layer_of(base), rest)
options = ColorFitOptions(steps=300, batch_pixels=4096)
fit = fit_color(usable.captures, usable.circles, surfaces, options=options)
profile = fit.apply_to(base)
print(f"{len(usable.circles)} presses; colours of {profile.grid().width_px} x", end=" ")
print(f"{profile.grid().height_px} pixels")

# %% [markdown]
# ## 2. Eight sensors at once
#
# Learning wants few nodes: here 651 and linear elements. What that costs comes at the end. Each
# environment presses at its own place and to its own depth. `FineSurface` draws the ball's own
# surface where it touches, so that images are not as coarse as the mesh.

# %%
from taccel_lab import (
    FineSurface,
    KinematicBody,
    MarkerLayout,
    Outputs,
    SignalTactile,
    SolverIPC,
    initial_state,
    profile_scene,
    to_torch,
)
from taccel_lab.cad.mesh.gel_mesh import gel_mesh
from taccel_lab.scene import Ball, Element
from taccel_lab.sensors.registry import sensor_family

ENVS, RADIUS_M = 8, 3e-3
mesh = gel_mesh(sensor_family("gelsight").parameters(base.sensor.parameters).pad(), edge_mm=4)
ball = KinematicBody(Ball(RADIUS_M), name="ball")
coarse = {"mesh": mesh, "gel": {"element": Element.LINEAR}, "kinematic_bodies": ball}
scene = profile_scene(profile, **coarse, env_count=ENVS)
dots_mm = np.stack(np.meshgrid(np.linspace(-6, 6, 9), np.linspace(-5, 5, 7)), axis=-1).reshape(
    -1, 2
)
layout = MarkerLayout.from_points(mesh, dots_mm)
solver = SolverIPC(scene.finalize("cpu"))
fine = FineSurface(solver, ball.name, profile.grid())
sensor = SignalTactile.from_profile(profile, solver=solver, fine=fine, markers=layout)
outputs = Outputs(solver)

random = torch.Generator().manual_seed(0)
places_mm = 8 * torch.rand(ENVS, 2, generator=random, dtype=torch.float64) - 4
depths_mm = torch.linspace(0.2, 0.9, ENVS, dtype=torch.float64)
top_m = float(mesh.nodes_m[:, 2].max())


def poses_at(places_mm, depth_mm):
    """Ball centres over the flat face, [env, 1 body, 7]: metres, quaternion."""
    pose = torch.zeros(len(places_mm), 1, 7, dtype=torch.float64)
    pose[:, 0, :2], pose[..., 6] = 1e-3 * places_mm, 1.0
    pose[:, 0, 2] = top_m + RADIUS_M - 1e-3 * depth_mm
    return pose


state = initial_state(solver.model, poses_at(places_mm, -0.1 * torch.ones(ENVS)).numpy())
sensor.update(state)
dots_at_rest = to_torch(sensor.markers_px).clone()
seconds, converged = time.perf_counter(), []
for part in (0.25, 0.5, 0.75, 1.0):
    report = solver.step(state, poses_at(places_mm, part * depths_mm).numpy())
    converged.append(report.converged.all())
seconds = time.perf_counter() - seconds
sensor.update(state)
rgb, dots = (to_torch(array) for array in sensor.read("rgb", "markers_px"))
wrench = -to_torch(outputs.update(state).soft_wrenches())[:, 0]  # of the gel on the ball
print(f"{mesh.node_count} nodes, {ENVS} environments: {4 * ENVS / seconds:.1f} steps a second")
print("rgb    ", tuple(rgb.shape), rgb.dtype)
print("markers", tuple(dots.shape), dots.dtype)
print("wrench ", tuple(wrench.shape), wrench.dtype, "force along z [N]:")
print(wrench[:, 2].numpy().round(3))

# %%
figure, axes = plt.subplots(2, 4, figsize=(13, 5.6))
for axis, image, now, before, depth_mm in zip(
    axes.flat, rgb, dots, dots_at_rest, depths_mm, strict=True
):
    axis.imshow(image)
    axis.quiver(*before.T, *(now - before).T, angles="xy", scale_units="xy", scale=0.15, color="w")
    axis.set_title(f"{depth_mm:.1f} mm")
    axis.axis("off")
figure.tight_layout()

# %% [markdown]
# Arrows are the motions of imagined dots, drawn 7 times as long.
#
# ## 3. Gradients of the solver
#
# `TorchMotion` is the same motion as a function of torch: what comes out has gradients over the
# ball's poses, the moduli and friction. One backward pass gives all of them. Here the slope of the
# force over the depth, beside a difference of two runs.

# %%
from taccel_lab.gradients.torch_motion import TorchMotion
from taccel_lab.signals.torch_signals import marker_places

moving = TorchMotion(profile_scene(profile, **coarse, env_count=ENVS).finalize("cpu"))


def press(depths_mm):
    """Node positions [m] and forces on the balls [N] after a press of all environments."""
    way = [poses_at(places_mm, depth) for depth in (0 * depths_mm - 0.02, depths_mm / 2, depths_mm)]
    moved = moving(torch.stack(way))
    assert moved.causes == [None] * ENVS, moved.causes
    return moved.positions[-1], moved.wrenches[-1, :, 0, 2]


at = depths_mm.clone().requires_grad_(True)
force = press(at)[1]
(slope,) = torch.autograd.grad(force.sum(), at)
difference = (press(depths_mm + 1e-3)[1] - press(depths_mm - 1e-3)[1]) / 2e-3
print("slope [N/mm]      ", slope.numpy().round(4))
print("by differences    ", difference.numpy().round(4))

# %% [markdown]
# ## 4. As deep as half a newton
#
# Newton's method in all environments at once: each goes deeper by the force that it lacks over its
# own slope.

# %%
WISHED_N = 0.5
depth, track = depths_mm.clone(), []
seconds = time.perf_counter()
for _ in range(8):
    at = depth.clone().requires_grad_(True)
    force = press(at)[1]
    track.append((depth.numpy().copy(), force.detach().numpy()))
    if (force.detach() - WISHED_N).abs().max() < 1e-6:
        break
    (slope_now,) = torch.autograd.grad(force.sum(), at)
    depth = depth + (WISHED_N - force.detach()) / slope_now
seconds = time.perf_counter() - seconds
depth_track, force_track = (np.array(rows) for rows in zip(*track, strict=True))
print(f"{len(track)} presses of {ENVS} gels in {seconds:.1f} s")
print("depths [mm]:", depth_track[-1].round(3))

figure, axes = plt.subplots(1, 2, figsize=(11, 3.4))
axes[0].plot(depth_track, "o-")
axes[0].set(xlabel="press", ylabel="depth [mm]")
axes[1].semilogy(np.abs(force_track - WISHED_N) + 1e-16, "o-")
axes[1].set(xlabel="press", ylabel="force off by [N]")
for axis in axes:
    axis.grid(alpha=0.3)

# %% [markdown]
# Depths differ though the gel is one and the same: near its edge it is softer. And coarse cells do
# the rest, as the next section shows.
#
# ## 5. What the coarse gel is worth
#
# The same touch once more as `taccel-lab press` simulates it by default: ten-node elements, cells
# that follow the contact.

# %%
from taccel_lab import PressEnv, parse_indenter, profile_material
from taccel_lab.sensors.press_mesh import profile_press_mesh

ENV = int(places_mm.norm(dim=1).argmin())
place_mm, depth_mm = places_mm[ENV].numpy(), float(depth[ENV])
tool = parse_indenter(f"sphere:{1e3 * RADIUS_M:g}")
fine_mesh = profile_press_mesh(profile, tuple(place_mm), tool.contact(depth_mm))
material = profile_material(profile.material, fine_mesh)
truth = PressEnv(fine_mesh, material, tool, place_mm[None])
for part in (0.5, 1.0):
    truth.move_to(part * depth_mm)
true_n, error_n = truth.press_force[0, 2], truth.error_estimate().force_n[0]

on_fine = MarkerLayout.from_points(truth.mesh, dots_mm)
with torch.no_grad():
    coarse_dots = marker_places(press(depth)[0][ENV], layout)
coarse_way = coarse_dots - marker_places(torch.as_tensor(mesh.nodes_m), layout)
fine_way = marker_places(torch.as_tensor(truth.positions[0]), on_fine)
fine_way = fine_way - marker_places(torch.as_tensor(truth.mesh.nodes_m), on_fine)
too_stiff = WISHED_N / true_n - 1
off = ((coarse_way - fine_way)[:, :2].norm(dim=1).square().mean().sqrt() * 1e6).item()
whole = (fine_way[:, :2].norm(dim=1).square().mean().sqrt() * 1e6).item()
print(f"environment {ENV}, {depth_mm:.3f} mm deep at {place_mm.round(2)} mm")
print(f"force: batch {WISHED_N:.3f} N, press {true_n:.3f} +- {error_n:.3f} N: {too_stiff:+.0%}")
print(f"dots: off by {off:.0f} um (rms) where they move by {whole:.0f} um")

# %%
figure, axes = plt.subplots(1, 2, figsize=(11, 4), sharey=True)
for axis, way, title in (
    (axes[0], coarse_way, f"batch: {mesh.node_count} nodes, linear"),
    (axes[1], fine_way, f"default press: {truth.mesh.node_count} nodes, quadratic"),
):
    axis.quiver(*dots_mm.T, *1e3 * way[:, :2].T.numpy(), angles="xy", scale_units="xy", scale=0.04)
    axis.plot(*place_mm, "r+", ms=14)
    axis.set(title=title, xlabel="x [mm]", aspect="equal")
axes[0].set_ylabel("y [mm], motion of the dots x 25")
axes[0].invert_yaxis()

# %% [markdown]
# Silicone hardly changes its volume, and linear tets then lock: forces and dots of this batch are
# those of its mesh, not of the sensor. It is good for trying code. To learn from, take ten-node
# elements (leave `element` out) and finer cells; [run time against error](04_time_and_error.ipynb)
# has the price.
#
# Colours have no way back: they are kernels without gradients. Losses of images go by markers
# (`marker_places`) or heights (`height_map`).

# %%
assert all(converged) and rgb.shape == (ENVS, profile.grid().height_px, profile.grid().width_px, 3)
assert (wrench[:, 2] > 0).all() and wrench[-1, 2] > wrench[0, 2]
assert (slope / difference - 1).abs().max() < 1e-3
assert np.abs(force_track[-1] - WISHED_N).max() < 1e-6
assert too_stiff > 0.1 and off > 0.2 * whole
