#!/usr/bin/env python3
"""A rig with more cameras, or of another rate: those of a rig, turned about the world's z axis.

    python3 packaging/tools/ring_rig.py assets/rig-200hz.json -o five.json [--cameras 5] [--hz 100]

With five cameras at 100 Hz it is of the size for which strand-braid publishes its latency; `vitreo certify --rig five.json
--load none` measures ours (docs/latency.md). The first camera is kept; the others see the same from around the axis.
"""
import argparse
import json
import math
import sys


def turned(camera, number, of):
    """The camera, in place `number` of `of` around the axis: R·Rz(−angle), t as it was."""
    angle = 2 * math.pi * number / of
    c, s = math.cos(angle), math.sin(angle)
    back = [[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]
    R = [[sum(row[k] * back[k][j] for k in range(3)) for j in range(3)] for row in camera["R"]]
    return dict(camera, id=number, R=R)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rig", help="rig file of which the first camera is taken")
    parser.add_argument("-o", "--output", required=True, help="rig file to write; not overwritten")
    parser.add_argument("--cameras", type=int, default=5, help="2 to 8 [default: 5]")
    parser.add_argument("--hz", type=float, default=100.0, help="fields per second [default: 100]")
    args = parser.parse_args()
    if not 2 <= args.cameras <= 8:
        sys.exit(f"--cameras {args.cameras}: expected 2 to 8")
    with open(args.rig) as file:
        rig = json.load(file)
    rig["cameras"] = [turned(rig["cameras"][0], n, args.cameras) for n in range(args.cameras)]
    rig["field_hz"] = args.hz
    try:
        with open(args.output, "x") as file:
            json.dump(rig, file, indent=1)
    except FileExistsError:
        sys.exit(f"{args.output}: exists; not overwritten")


if __name__ == "__main__":
    main()
