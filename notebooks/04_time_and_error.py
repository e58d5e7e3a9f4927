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
# # Run time against error
#
# How long must a press take to be right to a per cent? One press, simulated with linear and
# quadratic elements, coarse and fine, and with looser and tighter tolerances: seconds against the
# error of the force.
#
# Times are processor seconds of one core. They depend on the machine and on what else runs there;
# their ratios less so, and the errors not at all. Compiling kernels (once) is not in them.

# %%
import os
import platform
import time
from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

from taccel_lab import Element, parse_indenter, profile_material
from taccel_lab.presses import (
    PHYSICS,
    Accuracy,
    PressMeshOptions,
    PressPath,
    PressSetup,
    SeenFrom,
    simulate_press,
)
from taccel_lab.presses.bonded_layer import layer_force_n
from taccel_lab.presses.mesh import refined_press_mesh
from taccel_lab.presses.numerical_error import measured_press
from taccel_lab.sensors.profile import catalogue_profile
from taccel_lab.sensors.registry import profile_parameters

plt.rcParams["figure.dpi"] = 60
print(f"{platform.machine()}, {os.cpu_count()} cores, one of them used; others may be at work too")

profile = catalogue_profile("flat_pad")
pad = profile_parameters(profile).pad()
ball = parse_indenter("sphere:4")
DEPTH_MM = 0.4


def press(physics):
    """Force [N], its numerical error [N], processor seconds and nodes of a press in two steps. A
    coarser press of quadratic elements beside it tells the error and is in the seconds."""

    def at(resolution):
        contact, finer = ball.contact(DEPTH_MM), resolution.mesh
        mesh = refined_press_mesh(pad, (0, 0), contact, physics.mesh, finer)
        near = replace(physics, dhat_m=resolution.dhat * physics.dhat_m)
        gel = profile_material(profile.material, mesh)
        setup = PressSetup(mesh, gel, ball, physics=near)
        path = PressPath(DEPTH_MM).with_steps(resolution.steps)
        return simulate_press(setup, (0, 0), path, SeenFrom(profile.grid().thinned(8)))

    started = time.process_time()
    found = measured_press(at, physics, ball.shape, friction=0.0, remembers=False)
    press = found.error.stated_for(found.outcome)
    seconds = time.process_time() - started
    return press.force_n, press.force_error_n, seconds, press.mesh.node_count


# %% [markdown]
# ## 1. Elements and meshes
#
# The finest mesh is the reference. It has a witness: the exact linear solution of a glued layer,
# which knows no mesh at all (and no large strains).

# %%
fast, default = PHYSICS[Accuracy.FAST], PHYSICS[Accuracy.DEFAULT]
finer = PressMeshOptions(elements_per_radius=5.0, core=6, rings=12, layers=4)
finest = PressMeshOptions(elements_per_radius=6.5, core=8, rings=14, layers=4)
wide = PressMeshOptions(elements_per_radius=2.0, core=4, rings=4, layers=2)
very_fine = PressMeshOptions(elements_per_radius=9.0, core=10, rings=16, layers=5)
meshes = {"coarse": wide, "fast": fast.mesh, "default": default.mesh, "finer": finer}
cases = {f"quadratic, {name}": replace(default, mesh=mesh) for name, mesh in meshes.items()}
linear = replace(default, element=Element.LINEAR)
for name, mesh in {**meshes, "very fine": very_fine}.items():
    cases[f"linear, {name}"] = replace(linear, mesh=mesh)

press(cases["linear, coarse"]), press(cases["quadratic, coarse"])  # loads kernels
found = {name: press(physics) for name, physics in cases.items()}
reference_n, reference_error_n, reference_s, reference_nodes = press(replace(default, mesh=finest))
material = profile.material
layer_n = float(
    layer_force_n(
        "sphere",
        np.array(DEPTH_MM),
        4.0,
        profile.gel.thickness_mm,
        material.poisson_ratio,
        material.young_modulus_pa,
    )
)
print(
    f"reference: {reference_n:.4f} +- {reference_error_n:.4f} N, {reference_nodes} nodes, ", end=""
)
print(f"{reference_s:.1f} s; closed form {layer_n:.4f} N ({layer_n / reference_n - 1:+.1%})")
print("                      nodes  seconds  force [N]  off by  it says")
for name, (force_n, error_n, seconds, nodes) in found.items():
    off, says = force_n / reference_n - 1, error_n / reference_n
    print(f"{name:<21} {nodes:6} {seconds:8.2f} {force_n:10.4f} {off:+7.1%} +-{says:.1%}")

# %%
figure, axes = plt.subplots(1, 2, figsize=(12, 4.2))
for kind, mark in (("linear", "s--"), ("quadratic", "o-")):
    of_kind = [row for name, row in found.items() if name.startswith(kind)]
    force_n, error_n, seconds, nodes = np.array(of_kind).T
    off = np.abs(force_n / reference_n - 1)
    axes[0].loglog(seconds, off, mark, label=kind)
    axes[1].loglog(error_n / reference_n, off, mark, label=kind)
for name, row in found.items():
    axes[0].annotate(name.split(", ")[1], (row[2], abs(row[0] / reference_n - 1)), fontsize=8)
axes[0].axhspan(
    1e-5, reference_error_n / reference_n, color="0.9", label="reference's own estimate"
)
axes[0].set(xlabel="processor seconds", ylabel="error of the force", ylim=(1e-4, 2))
axes[1].loglog([1e-2, 1], [1e-2, 1], "k", lw=0.8)
axes[1].set(xlabel="error that the press states", ylabel="error of the force", ylim=(1e-4, 2))
for axis, place in zip(axes, ("lower left", "upper left"), strict=True):
    axis.legend(loc=place)
    axis.grid(alpha=0.3)

# %% [markdown]
# Linear elements converge from far away: gel is nearly incompressible, and linear tets lock. In
# about the same time the finest linear mesh is farther off than the coarsest quadratic one. Every
# press states its error (right; below the line it kept its word): linear ones are off by 0.4 to 0.5
# of what they state, quadratic ones by less. In the grey band the reference is no better itself: of
# an error there it is only known that it is small.

# %%
figure, axis = plt.subplots(figsize=(8, 3.8))
for kind, mark in (("linear", "s--"), ("quadratic", "o-")):
    force_n, error_n, _, nodes = np.array([v for k, v in found.items() if k.startswith(kind)]).T
    axis.errorbar(nodes, force_n, error_n, fmt=mark, capsize=4, label=kind)
axis.axhline(reference_n, color="k", lw=0.8, label="reference")
axis.axhline(layer_n, color="0.6", ls=":", label="closed form")
axis.set(xlabel="nodes", ylabel="force [N], with the error it states", xscale="log")
legend = axis.legend()

# %% [markdown]
# ## 2. Tolerance and contact range
#
# Two more knobs: at which residual a step has converged, and at which gap contact begins (`dhat`).
# The indenter is held back by the gap that its contact keeps, so a large range costs little.

# %%
knobs = {}
for tolerance in (1e-1, 1e-2, 1e-3, 1e-4, 1e-6):
    knobs["tolerance", tolerance] = press(replace(default, relative_tolerance=tolerance))
for dhat_um in (100, 30, 10, 3):
    knobs["contact range [um]", dhat_um] = press(replace(default, dhat_m=1e-6 * dhat_um))
tight_n = knobs["tolerance", 1e-6][0]
print("knob                 value   seconds  force off the tightest tolerance's by")
for (name, value), (force_n, _, seconds, _) in knobs.items():
    print(f"{name:<18} {value:7g} {seconds:9.2f} {force_n / tight_n - 1:+14.3%}")

# %%
figure, axes = plt.subplots(1, 2, figsize=(12, 3.6))
for axis, knob in zip(axes, ("tolerance", "contact range [um]"), strict=True):
    values = [value for name, value in knobs if name == knob]
    rows = np.array([knobs[knob, value] for value in values])
    axis.semilogx(values, 100 * (rows[:, 0] / tight_n - 1), "o-")
    axis.set(xlabel=knob, ylabel="force off by [%]")
    seconds_axis = axis.twinx()
    seconds_axis.semilogx(values, rows[:, 2], "s--", color="0.6")
    seconds_axis.set_ylabel("processor seconds (grey)")
    seconds_axis.set_ylim(0)
figure.tight_layout()

# %% [markdown]
# The mesh decides. A looser tolerance saves little time and a wider contact range neither: leave
# both, and choose elements and cells.

# %%
off = {name: abs(row[0] / reference_n - 1) for name, row in found.items()}
assert off["quadratic, default"] < 0.03 and abs(layer_n / reference_n - 1) < 0.03
assert min(off[name] for name in off if name.startswith("linear")) > off["quadratic, fast"]
assert off["linear, coarse"] > off["linear, default"] > off["linear, very fine"] > 0.03
says = {name: row[1] / reference_n for name, row in found.items()}
assert all(0.3 < off[name] / says[name] < 0.6 for name in off if name.startswith("linear, "))
assert all(abs(row[0] - reference_n) < row[1] + reference_error_n for row in found.values())
assert abs(knobs["tolerance", 1e-4][0] / tight_n - 1) < 1e-3
