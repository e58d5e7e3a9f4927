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
# # A profile in torch: one image, many sensors, and gradients
#
# A profile reads images and renders them. In torch it becomes a batch of sensors: images, markers,
# wrenches, gradients. These say how deep each tool must go for a force; a finer press says what the
# coarse gel of the batch was worth.
#
# ## 1. A press, its image, and the depth that is read from it
#
# The catalogue's Mini has the colours of a unit that others calibrated: good for trying code.
# [The main job](00_main_job.ipynb) calibrates your own.

# %%
import time

import matplotlib.pyplot as plt
import numpy as np
import torch

import taccel_lab as tl

plt.rcParams["figure.dpi"] = 60

sensor = tl.load_sensor("gelsight_mini")
press = sensor.press("sphere:4", depth_mm=0.5, accuracy="fast")
reading = sensor.read(press.image, background=sensor.background_rgb)
again = sensor.render(reading.height_m)
print(f"pressed {press.travel_mm:.3f} mm deep with {press.force_n:.2f} N")
print(f"read    {reading.depth_words}; {reading.force_n:.2f} N")

# %%
figure, axes = plt.subplots(1, 4, figsize=(13, 2.8))
for axis, (title, shown) in zip(
    axes,
    {
        "image": press.image,
        "depth pressed [mm]": 1e3 * press.depth_m,
        "depth read [mm]": 1e3 * reading.depth_m,
        "image of what was read": again,
    }.items(),
    strict=True,
):
    drawn = axis.imshow(shown)
    axis.set_title(title)
    axis.axis("off")
    if shown.ndim == 2:
        figure.colorbar(drawn, ax=axis, shrink=0.8)
figure.tight_layout()

# %% [markdown]
# The read depth is that of the resting gel, which is curved: `reading.height_m` keeps the curve,
# `reading.points_m` is the point cloud, and `reading.save_ply` writes the surface.
#
# ## 2. Eight sensors at once
#
# Learning wants few nodes: here some hundreds and linear elements. What that costs comes at the
# end. Each environment presses at its own place and to its own depth. `FineSurface` draws the
# ball's own surface where it touches, so that images are not as coarse as the mesh.

# %%
ENVS, RADIUS_M = 8, 3e-3
FRICTION = sensor.material.friction_coefficient
mesh = sensor.meshed(edge_mm=4)
ball = tl.KinematicBody(tl.Ball(RADIUS_M), name="ball", friction_coefficient=FRICTION)
coarse = {"mesh": mesh, "gel": {"element": tl.Element.LINEAR}, "kinematic_bodies": ball}
scene = tl.profile_scene(sensor, **coarse, env_count=ENVS)
dots_mm = np.stack(np.meshgrid(np.linspace(-6, 6, 9), np.linspace(-5, 5, 7)), axis=-1).reshape(
    -1, 2
)
layout = tl.MarkerLayout.from_points(mesh, dots_mm)
solver = tl.SolverIPC(scene.finalize("cpu"))
fine = tl.FineSurface(solver, ball.name, sensor.grid())
signals = tl.SignalTactile.from_profile(sensor, solver=solver, fine=fine, markers=layout)
outputs = tl.Outputs(solver)

random = torch.Generator().manual_seed(0)
places_mm = 8 * torch.rand(ENVS, 2, generator=random, dtype=torch.float64) - 4
depths_mm = torch.linspace(0.2, 0.9, ENVS, dtype=torch.float64)
u, v = sensor.grid().pixel_from_gel(places_mm.numpy()).round().astype(int).T
rest_m = torch.as_tensor((reading.height_m + reading.depth_m)[v, u])  # the resting face there


def poses_at(places_mm, depth_mm):
    """Ball centres so deep from first touch, [env, 1 body, 7]: metres, quaternion."""
    pose = torch.zeros(len(places_mm), 1, 7, dtype=torch.float64)
    pose[:, 0, :2], pose[..., 6] = 1e-3 * places_mm, 1.0
    pose[:, 0, 2] = rest_m + RADIUS_M - 1e-3 * depth_mm
    return pose


state = tl.initial_state(solver.model, poses_at(places_mm, -0.1 * torch.ones(ENVS)).numpy())
signals.update(state)
dots_at_rest = tl.to_torch(signals.markers_px).clone()
seconds, converged = time.perf_counter(), []
for part in (0.25, 0.5, 0.75, 1.0):
    report = solver.step(state, poses_at(places_mm, part * depths_mm).numpy())
    converged.append(report.converged.all())
seconds = time.perf_counter() - seconds
signals.update(state)
rgb, dots = (tl.to_torch(array) for array in signals.read("rgb", "markers_px"))
wrench = -tl.to_torch(outputs.update(state).soft_wrenches())[:, 0]  # of the gel on the ball
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
moving = tl.TorchMotion(tl.profile_scene(sensor, **coarse, env_count=ENVS).finalize("cpu"))


def pressed(depths_mm):
    """Node positions [m] and forces on the balls [N] after a press of all environments."""
    way = [poses_at(places_mm, depth) for depth in (0 * depths_mm - 0.02, depths_mm / 2, depths_mm)]
    moved = moving(torch.stack(way))
    assert moved.causes == [None] * ENVS, moved.causes
    return moved.positions[-1], moved.wrenches[-1, :, 0, 2]


at = depths_mm.clone().requires_grad_(True)
force = pressed(at)[1]
(slope,) = torch.autograd.grad(force.sum(), at)
difference = (pressed(depths_mm + 1e-3)[1] - pressed(depths_mm - 1e-3)[1]) / 2e-3
print("slope [N/mm]      ", slope.numpy().round(4))
print("by differences    ", difference.numpy().round(4))

# %% [markdown]
# ## 4. As deep as two newtons
#
# Newton's method in all environments at once: each goes deeper by the force that it lacks over its
# own slope.

# %%
WISHED_N = 2.0
depth, track = depths_mm.clone(), []
seconds = time.perf_counter()
for _ in range(8):
    at = depth.clone().requires_grad_(True)
    force = pressed(at)[1]
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
ENV = int(places_mm.norm(dim=1).argmin())
place_mm, depth_mm = places_mm[ENV].numpy(), float(depth[ENV])
truth = sensor.press(f"sphere:{1e3 * RADIUS_M:g}", depth_mm=depth_mm, at_mm=tuple(place_mm))
true_n, error_n = truth.force_n, truth.force_error_n

fine_mesh = truth.mesh
on_fine = tl.MarkerLayout.from_points(fine_mesh, dots_mm)
with torch.no_grad():
    coarse_dots = tl.marker_places(pressed(depth)[0][ENV], layout)
coarse_way = coarse_dots - tl.marker_places(torch.as_tensor(mesh.nodes_m), layout)
fine_way = tl.marker_places(torch.as_tensor(truth.positions_m), on_fine)
fine_way = fine_way - tl.marker_places(torch.as_tensor(fine_mesh.nodes_m), on_fine)
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
    (axes[1], fine_way, f"default press: {fine_mesh.node_count} nodes, quadratic"),
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
# (`tl.marker_places`) or heights (`tl.height_map`).

# %%
assert all(converged) and rgb.shape == (ENVS, *sensor.background_rgb.shape)
assert (wrench[:, 2] > 0).all() and wrench[-1, 2] > wrench[0, 2]
assert (slope / difference - 1).abs().max() < 1e-3
assert np.abs(force_track[-1] - WISHED_N).max() < 1e-6
assert too_stiff > 0.1 and off > 0.2 * whole
