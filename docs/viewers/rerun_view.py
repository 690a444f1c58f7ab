#!/usr/bin/env python3
"""rerun_view.py FILE.mcap [--save FOLDER]: shows a recording in Rerun, laid out for it.

Needs `pip install rerun-sdk` (0.41). The recording is converted by Rerun's own MCAP importer; nothing of
vitreo is needed. With --save nothing is opened: vitreo.rrd and vitreo.rbl (the layout) are written to FOLDER,
for `rerun vitreo.rrd vitreo.rbl`. A layout belongs to one version of Rerun, hence this script.
"""

import argparse
import subprocess
import tempfile
from pathlib import Path

import rerun.blueprint as rrb

APPLICATION = "vitreo"


def blueprint():
    """Bodies and cameras in space, the picture, each camera's matches, events, and the numbers."""
    cameras = [rrb.Spatial2DView(origin=f"/camera{n}/matches", name=f"camera {n}") for n in range(3)]
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                rrb.Spatial3DView(origin="/", name="instruments, eye and cameras"),
                rrb.Spatial2DView(origin="/picture", name="the surgeon's picture"),
                row_shares=[3, 2],
            ),
            rrb.Vertical(
                rrb.Horizontal(*cameras),
                rrb.TextLogView(origin="/log", name="events"),
                rrb.DataframeView(origin="/poses", name="poses"),
            ),
        ),
        rrb.TimePanel(state="expanded"),
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recording", type=Path)
    parser.add_argument("--save", type=Path, metavar="FOLDER")
    args = parser.parse_args()
    folder = args.save or Path(tempfile.mkdtemp(prefix="vitreo-"))
    folder.mkdir(parents=True, exist_ok=True)
    recording, layout = folder / "vitreo.rrd", folder / "vitreo.rbl"
    convert = ["rerun", "mcap", "convert", str(args.recording), "-o", str(recording)]
    subprocess.run([*convert, "--application-id", APPLICATION], check=True)
    blueprint().save(APPLICATION, str(layout))
    if not args.save:
        subprocess.run(["rerun", str(recording), str(layout)], check=True)


if __name__ == "__main__":
    main()
