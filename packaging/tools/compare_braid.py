#!/usr/bin/env python3
"""The tracker beside strand-braid's, in turns on one machine: time per instant of all cameras.

    git clone https://github.com/strawlab/strand-braid
    python3 packaging/tools/compare_braid.py strand-braid [--turns 5] [--build] [--json]

strand-braid's own bench, braid-sim-bench, tracks simulated insects that are one point each: three cameras and 14 points,
as many as the markers of both instruments and of the eye. Only its pixels show which points are there,
as our tracker is; it gives 14 points, ours three poses. --build compiles it, with the two dependencies that come from
git repositories, mp4 and y4m, taken from crates.io instead (nothing that the bench runs uses them); five minutes on a
quiet machine. Ours is `cargo bench -p tracker --bench field`, its row "full triple", and what follows once the poses
were sent is in it. The ratio of each turn is that of neighbours in time, so that other work on the machine counts for both.
"""
import argparse
import csv
import json
import os
import re
import statistics
import subprocess
import sys
import tempfile

ROOT = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "..")
CAMERAS, POINTS = 3, 14
BENCH = "braid-sim-bench"
FROM_CRATES = {"mp4": "0.14", "y4m": "0.8"}


def build(peer):
    manifest = os.path.join(peer, "Cargo.toml")
    with open(manifest) as file:
        text = file.read()
    for name, version in FROM_CRATES.items():
        text, found = re.subn(rf"^{name} = {{ git = .*$", f'{name} = "{version}"', text, flags=re.M)
        if not found and f'{name} = "{version}"' not in text:
            sys.exit(f"{manifest}: no line '{name} = {{ git = … }}': is this another version of strand-braid?")
    with open(manifest, "w") as file:
        file.write(text)
    command = ["cargo", "build", "--release", "-p", "braid-sim", "--features", "inprocess", "--bin", BENCH]
    subprocess.run(command, cwd=peer, check=True)


def theirs(peer, frames):
    """Microseconds for one instant of all cameras."""
    program = os.path.join(peer, "target", "release", BENCH)
    if not os.path.exists(program):
        sys.exit(f"{program} is not there: build it with --build")
    with tempfile.TemporaryDirectory(dir="/dev/shm" if os.path.isdir("/dev/shm") else None) as scratch:
        out = os.path.join(scratch, "bench.csv")
        command = [program, "--cameras", str(CAMERAS), "--insects", str(POINTS), "--frames", str(frames), "--reps", "1"]
        run = subprocess.run(command + ["--csv", out, "--work-dir", scratch], capture_output=True, text=True)
        if run.returncode:
            sys.exit(f"{BENCH} ended with {run.returncode}:\n{run.stderr}")
        with open(out) as file:
            row = next(csv.DictReader(file))
    if int(row["num_objects"]) < POINTS:
        sys.exit(f"{BENCH} tracked {row['num_objects']} of {POINTS} points: its time says nothing")
    return CAMERAS * float(row["us_per_cam_frame"])


def ours(compiled):
    """The same of our tracker."""
    command = ["cargo", "bench", "-q", "-p", "tracker", "--bench", "field", "--", "--json"]
    command = [compiled, "--json"] if compiled else command
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    if run.returncode:
        sys.exit(f"{' '.join(command)} ended with {run.returncode}:\n{run.stderr}")
    rows = [json.loads(line) for line in run.stdout.splitlines() if line.startswith("{")]
    return next(row["median_us"] for row in rows if row["method"] == "full triple")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("peer", metavar="DIR", help="a clone of strand-braid")
    parser.add_argument("--turns", type=int, default=5, help="how often each is run [default: 5]")
    parser.add_argument("--frames", type=int, default=2000, help="instants that strand-braid tracks [default: 2000]")
    parser.add_argument("--build", action="store_true", help="compile strand-braid's bench first")
    parser.add_argument("--field-bench", metavar="FILE", help="our bench, already compiled [default: by cargo]")
    parser.add_argument("--json", action="store_true", help="figures for another program")
    args = parser.parse_args()
    if args.turns < 1 or args.frames < 100:
        parser.error("at least one turn, and 100 frames")
    if args.build:
        build(args.peer)
    ours(args.field_bench)  # Compiled, and run once to warm up.
    turns = []
    for _ in range(args.turns):
        turns.append({"braid_us": theirs(args.peer, args.frames), "vitreo_us": ours(args.field_bench)})
    ratios = [turn["braid_us"] / turn["vitreo_us"] for turn in turns]
    ratio = statistics.median(ratios)
    if args.json:
        print(json.dumps({"turns": turns, "ratio": ratio}))
        return
    for turn, each in zip(turns, ratios):
        print(f"strand-braid {turn['braid_us']:7.1f} µs, vitreo {turn['vitreo_us']:7.1f} µs: {each:.2f} times")
    print(f"median {ratio:.2f} times: {CAMERAS} cameras, {POINTS} points or markers, one instant of all cameras")


if __name__ == "__main__":
    main()
