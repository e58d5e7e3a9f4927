# SPDX-License-Identifier: Apache-2.0
"""Colour networks with the position as sines and cosines: device against host, images a second.

Random networks of three layers of 64 units, images of 320 x 240 pixels. Run it with
``python -m taccel_lab.benchmarks.position_bands``; results go to
``benchmarks/results/position_bands.json``.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

from taccel_lab.benchmarks.machine import describe_run
from taccel_lab.output import write_json
from taccel_lab.signals.color_model import ColorModel, ColorModelConfig, expected_shapes
from taccel_lab.signals.device_color import DeviceColorModel
from taccel_lab.signals.normals import normals_from_slopes

RESULT = Path(__file__).parent / "results" / "position_bands.json"
WIDTH, HEIGHT = 320, 240
BANDS = (0, 1, 4, 8)
UNTOUCHED_ROWS = 50
"""Of the first image, which have to show the bare background."""


def random_model(bands: int, seed: int = 0) -> ColorModel:
    """Weights that keep the spread of the inputs."""
    config = ColorModelConfig(
        WIDTH, HEIGHT, hidden=(64, 64, 64), position_bands=bands,
        input_mean=(0.0, 0.0, 0.0, 0.0, 0.95, -0.1), input_scale=(0.6, 0.6, 0.2, 0.2, 0.1, 0.2),
    )  # fmt: skip
    rng = np.random.default_rng(seed)
    return ColorModel(
        config,
        {
            name: rng.normal(0, 1.2 / np.sqrt(shape[-1]), shape)
            for name, shape in expected_shapes(config).items()
        },
    )


def measure(bands: int, images: int, device: str, repeats: int) -> dict[str, object]:
    """Errors of two images in levels, and the time of ``images`` at once."""
    import warp as wp

    model, rng = random_model(bands), np.random.default_rng(1)
    rest = np.concatenate(
        [rng.normal(0, 0.05, (HEIGHT, WIDTH, 2)), np.zeros((HEIGHT, WIDTH, 1))], -1
    )
    surface = rest + rng.normal(0, 1, (2, HEIGHT, WIDTH, 3)) * [0.3, 0.3, 2e-4]
    surface[0, :UNTOUCHED_ROWS] = rest[:UNTOUCHED_ROWS]
    background = rng.uniform(60, 190, (HEIGHT, WIDTH, 3)).astype(np.float32)

    def on_device(samples: np.ndarray) -> wp.array:
        return wp.array(samples.astype(np.float32), dtype=wp.vec3f, device=device)

    painter = DeviceColorModel(model, background, on_device(rest))
    levels = wp.empty((2, HEIGHT, WIDTH, 3), dtype=wp.float32, device=device)
    painter.render(on_device(surface), None, levels)
    expected = model.render(
        normals_from_slopes(surface[..., :2]),
        1e3 * (surface[..., 2] - rest[..., 2]),
        normals_from_slopes(rest[..., :2]),
        background,
    )
    error = np.abs(levels.numpy() - expected)
    untouched = levels.numpy()[0, :UNTOUCHED_ROWS] == background[:UNTOUCHED_ROWS]

    many = on_device(np.tile(surface[1:], (images, 1, 1, 1)))
    levels = wp.empty((images, HEIGHT, WIDTH, 3), dtype=wp.float32, device=device)
    seconds = []
    for _ in range(repeats + 1):
        started = time.perf_counter()
        painter.render(many, None, levels)
        wp.synchronize()
        seconds.append(time.perf_counter() - started)
    # The first one captures graphs and fills caches.
    seconds = seconds[1:]
    return {
        "position_bands": bands,
        "images": images,
        "width": WIDTH,
        "height": HEIGHT,
        "mean_error_levels": float(error.mean()),
        "max_error_levels": float(error.max()),
        "untouched_exact": bool(untouched.all()),
        "images_per_s": round(images / float(np.median(seconds))),
        "seconds": [round(second, 5) for second in seconds],
    }


def main() -> None:
    import warp as wp

    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--device", default="cpu", help="cpu or cuda:0 (cpu)")
    parser.add_argument("--images", type=int, default=2, help="at once (2; 1024 for a GPU)")
    parser.add_argument("--repeats", type=int, default=5, help="(5)")
    parser.add_argument("--out", type=Path, default=RESULT, help="JSON file")
    options = parser.parse_args()
    wp.config.log_level = wp.LOG_WARNING
    rows = []
    for bands in BANDS:
        rows.append(measure(bands, options.images, options.device, options.repeats))
        sys.stderr.write(
            f"{bands} bands: {rows[-1]['images_per_s']:,} images a second, error "
            f"{rows[-1]['max_error_levels']:.1e} levels\n"
        )
    write_json(
        options.out,
        {
            "what": (__doc__ or "").split("\n")[0],
            "run": describe_run(options.device),
            "rows": rows,
        },
    )


if __name__ == "__main__":
    main()
