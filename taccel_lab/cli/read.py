# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab read``: a recorded sequence in, depth, force and markers by frame out."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional


@dataclass(frozen=True)
class Read:
    """Read a recording frame by frame: a video, images, UniVTAC's HDF5 or a LeRobot data set.

    Every frame gives depth, contact area, normal force with its 95 % interval (contact of an
    elastic layer) and marker displacements, as far as the profile's blocks allow. Writes
    `readings.csv`, `readings.json` and curves over the frames, `readings.png`. Frames that cannot
    be read are rows with the reason. After an interrupt the same command goes on where it stopped.
    """

    profile: Positional[str]
    """Profile folder of this sensor, or a sensor of the catalogue with a starter profile."""
    source: Positional[Path]
    """A video, a folder of images in natural order, such as those of a rosbag, one image, an HDF5
    file of UniVTAC, or the folder of a LeRobot data set (v2, v3)."""
    out: Path
    """Folder to write."""
    camera: str | None = None
    """Camera of a data set that has several, by its name or the end of it: left_tactile/rgb."""
    background: Path | None = None
    """Image of the untouched sensor, if newer than the profile's. With a starter profile it is
    looked for: background.png beside the source, or the still frames of the recording."""
    fps: float | None = None
    """Frames a second, in place of the times that the source tells: a video's own, a LeRobot data
    set's, stamps in the names of images. A gel that relaxes is followed by them. Without any, the
    intervals of its forces reach from a long press to a sudden one."""
    json: bool = False
    """Print the rows as JSON."""

    def run(self) -> None:
        import numpy as np

        from taccel_lab.calibration.capture.camera.recording import Recording
        from taccel_lab.calibration.live.reader import LiveReader
        from taccel_lab.calibration.live.recorded import read_recorded, remarks_of
        from taccel_lab.calibration.untouched_frame import UntouchedFrame
        from taccel_lab.cli.console import notes, print_json, results
        from taccel_lab.files.output_folder import require_replaceable
        from taccel_lab.files.regular_file import file_sha256
        from taccel_lab.processes.start_warp import start_warp
        from taccel_lab.sensors.profile import profile_folder, stock_sensor
        from taccel_lab.version import __version__

        start_warp()
        require_replaceable(self.out)
        profile, own = stock_sensor(self.profile), profile_folder(self.profile)
        recording = Recording.of(self.source, self.camera, self.fps)
        found = UntouchedFrame.of(profile, [self.source], self.background, camera=self.camera)
        profile = found.profile
        untouched = profile.untouched(found.image, found.name).astype(np.float32)
        reader = LiveReader(profile, untouched, sigma_every=1)
        recipe = {
            "version": __version__,
            "profile": self.profile if own is None else file_sha256(own / "profile.toml"),
            "source": [str(self.source), recording.camera, recording.names],
            "background": hashlib.sha256(untouched.tobytes()).hexdigest(),
            "fps": self.fps,
        }
        console = notes()

        def bar(task: str, done: int, total: int) -> None:
            if done % 50 == 0 or done == total:
                console.print(f"{task}: {done} of {total}")

        rows = read_recorded(recording, reader, self.out, recipe, bar)
        if self.json:
            print_json({"out": str(self.out), "frames": rows})
            return
        forces = [row["force_n"] for row in rows if row.get("force_n") is not None]
        depths = [row["depth_mm"] for row in rows if row.get("depth_mm") is not None]
        refused = sum(bool(row["refused"]) for row in rows)
        said = f"{len(rows)} frames, {refused} refused"
        said += f", up to {max(depths):.3f} mm" if depths else ""
        said += f" and {max(forces):.3g} N" if forces else ""
        if any(row["time_s"] is not None for row in rows):
            said += f"; times: {recording.times_from}"
        for remark, count in remarks_of(rows):
            of = "" if count == len(rows) - refused else f" ({count} frames)"
            results().print(f"  {remark}{of}", soft_wrap=True)
        results().print(f"{said}\nwrote {self.out}", soft_wrap=True)
