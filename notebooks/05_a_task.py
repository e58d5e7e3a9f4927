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
# # A task: find a hole by touch
#
# Two gels hold a peg up to 3 mm beside its hole, and a fixed policy finds it by touch. It sees
# nothing but the markers of both gels: it pushes down, feels on which side the rim is, rises, steps
# away from that side and tries again, five times at most. This notebook looks at one try, scores a
# few seeds, and asks how well the markers must be seen.

# %%
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from taccel_lab import MarkerLayout, PixelGrid, SignalTactile
from taccel_lab.tasks.catalogue import named

plt.rcParams["figure.dpi"] = 60

task = named("touch-insertion")
wanted = task.parameters
print(wanted.summary)
print("done when:", wanted.criterion)
print(
    f"markers seen to {wanted.markers.noise_mm} mm; something is felt when they moved up by "
    f"{wanted.policy.felt_mm} mm on average"
)

# %% [markdown]
# ## 1. One seed, from the inside
#
# An episode is a solver with a policy around it, so every signal of the gels can be read after
# each step. A seed fixes the start and the noise.

# %%
SEED = 3
episode = task.begin([SEED], "cpu")
print("start:", {name: round(value, 2) for name, value in episode.starts[0].items()})
grid = PixelGrid(160, 130, 0.16, 0.16)
gels = [body.name for body in episode.scene.soft_bodies]
dots_mm = wanted.markers.points_mm()
sensors = [
    SignalTactile.from_solver(
        episode.solver,
        grid,
        gel=k,
        markers=MarkerLayout.from_points(body.nodal_mesh, dots_mm),
    )
    for k, body in enumerate(episode.scene.soft_bodies)
]


def felt():
    """Markers [px] and pressure [kPa] of both gels."""
    found = []
    for sensor in sensors:
        sensor.update(episode.state)
        markers, pressure = sensor.read("markers_px", "pressure_pa")
        found.append((markers.numpy()[0].copy(), pressure.numpy()[0] / 1e3))
    return found


rows, frames = [], []
while not episode.over:
    episode.advance()
    forces = episode.forces()
    rows.append([1e3 * episode.hands_m[0, 2], *(forces[name] for name in forces)])
    frames.append(felt())
names, rows = list(forces), np.array(rows)
(trial,) = episode.trials()
print(
    "success" if trial.success else trial.cause, {k: round(v, 2) for k, v in trial.figures.items()}
)

# %%
seconds = wanted.dt_s * np.arange(1, len(rows) + 1)
figure, axes = plt.subplots(2, 1, figsize=(11, 5), sharex=True)
axes[0].plot(seconds, rows[:, 0])
axes[0].set_ylabel("height of the hand [mm]")
for column, name in enumerate(names):
    axes[1].plot(seconds, rows[:, 1 + column], label=name)
axes[1].set(xlabel="time [s]", ylabel="force [N]")
legend = axes[1].legend()
for axis in axes:
    axis.grid(alpha=0.3)

# %% [markdown]
# Each rise of the hand is a try that felt the rim; the last way down is into the hole. What was
# felt at the first peak of the hole's force? The markers' motion since just before (up in the world
# is down in these pictures):

# %%
hole = rows[:, 1 + names.index("hole")]
first = int(np.argmax(hole > 0.05 * hole.max()))
peak = first + int(np.argmax(hole[first : first + 10]))
figure, axes = plt.subplots(1, 2, figsize=(12, 4.4))
mean_um = []
for axis, name, (before, _), (now, pressure) in zip(
    axes, gels, frames[first - 1], frames[peak], strict=True
):
    shown = axis.imshow(pressure, cmap="viridis", vmin=0)
    way = now - before
    axis.quiver(*before.T, *way.T, angles="xy", scale_units="xy", scale=0.05, color="w")
    mean_um.append(1e3 * grid.mm_per_px_x * np.linalg.norm(way.mean(axis=0)))
    axis.set_title(f"{name}: {mean_um[-1]:.0f} um (drawn x 20)")
    axis.axis("off")
    figure.colorbar(shown, ax=axis, shrink=0.8, label="pressure [kPa]")

# %% [markdown]
# The peg stands on the rim and pushes the gels up along their faces. It leans, so one gel's markers
# move more: that difference, some hundredths of a millimetre, is all that tells the side.
#
# ## 2. Score
#
# Seeds are environments of one solver, eight at a time. A rate of a few seeds is a wide interval;
# 64 seeds are in [task results](../docs/evidence/task_results.md).

# %%
from taccel_lab.tasks.catalogue import run_task

SEEDS = 24
result = run_task(task, seeds=range(SEEDS), device="cpu")
table = result.table()
low, high = table["interval_95"]
print(f"{table['successes']} of {table['trials']} in {result.seconds:.0f} s", end=": ")
print(f"{table['success_rate']:.0%}, 95 % interval {low:.0%} to {high:.0%}")
for trial in result.trials:
    if not trial.success:
        start = f"({trial.start['x_mm']:+.1f}, {trial.start['y_mm']:+.1f}) mm"
        print(f"seed {trial.seed}, from {start}: {trial.cause}, {trial.figures['tries']:.0f} tries")

# %% [markdown]
# ## 3. How well must markers be seen?
#
# A changed copy of the task's file is a task. The same starts, the same policy, another noise of
# the markers: this is a sensor's specification, judged by the task.

# %%
from taccel_lab.tasks.catalogue import FILES, read_task

text = (FILES / "touch-insertion.toml").read_text()
folder = Path(tempfile.mkdtemp())
rates = {}
for noise_mm in (0.003, 0.03, 0.1, 0.2):
    path = folder / f"noise-{noise_mm:g}.toml"
    path.write_text(text.replace("noise_mm = 0.03", f"noise_mm = {noise_mm:g}"))
    if noise_mm == wanted.markers.noise_mm:
        again = table
    else:
        again = run_task(read_task(path), seeds=range(SEEDS), device="cpu").table()
    rates[noise_mm] = again["success_rate"], *again["interval_95"]
    print(f"markers to {noise_mm:g} mm: {again['successes']} of {again['trials']}")

# %%
figure, axes = plt.subplots(1, 2, figsize=(12, 4))
for success, mark, color in ((True, "o", "C0"), (False, "X", "C3")):
    starts = [trial.start for trial in result.trials if trial.success == success]
    x, y = ([start[name] for start in starts] for name in ("x_mm", "y_mm"))
    axes[0].scatter(x, y, marker=mark, color=color, label="in" if success else "not in")
axes[0].set(title="starts", xlabel="x [mm]", ylabel="y [mm]", aspect="equal")
axes[0].legend()
noises = np.array(list(rates))
middle, low, high = 100 * np.array(list(rates.values())).T
axes[1].errorbar(noises, middle, [middle - low, high - middle], fmt="o-", capsize=4)
axes[1].set(xlabel="noise of the markers [mm]", ylabel="success [%]", xscale="log", ylim=(0, 100))
for axis in axes:
    axis.grid(alpha=0.3)

# %%
assert (hole[:first] < 0.05 * hole.max()).all() and abs(mean_um[0] - mean_um[1]) > 5
assert table["solver_failures"] == 0 and table["trials"] == SEEDS
assert rates[0.03][0] > 0.7 and rates[0.2][0] < rates[0.003][0]
