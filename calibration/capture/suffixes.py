# SPDX-License-Identifier: Apache-2.0
"""Pictures and videos by the endings of their names."""

from __future__ import annotations

from pathlib import Path

IMAGES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")
VIDEOS = (".avi", ".mp4", ".mov", ".mkv", ".webm")


def is_picture(path: Path | str) -> bool:
    """Whether a file is an image by its ending."""
    return Path(path).suffix.lower() in IMAGES


def is_video(path: Path) -> bool:
    """Whether a file is a video by its ending."""
    return path.suffix.lower() in VIDEOS
