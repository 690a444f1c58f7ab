#!/usr/bin/env python3
"""aruco_codes.py > tracker/calibration/src/charuco/codes.rs

Writes the markers of OpenCV's predefined dictionaries of 4x4 to 6x6 bits as a table of Rust: their bits, row by row from
the top left, the highest bit first, 1 for white; and how many wrong bits of a marker each dictionary can mend. The
dictionaries of one size begin alike: that of 50 markers is the beginning of that of 1000. Needs opencv-python-headless;
the committed table was made with 5.0.0. `--check FILE` compares instead.
"""
import sys

import cv2

SIDES = (4, 5, 6)
COUNTS = (50, 100, 250, 1000)


def dictionary(side, count):
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{side}X{side}_{count}"))


def codes(side, count):
    found = dictionary(side, count)
    for k in range(count):
        bits = cv2.aruco.Dictionary.getBitsFromByteList(found.bytesList[k : k + 1], side)
        yield int("".join(str(int(b)) for b in bits.ravel()), 2)


def table():
    out = [
        "//! Markers of OpenCV's predefined dictionaries (Garrido-Jurado et al., Generation of fiducial marker dictionaries",
        "//! using mixed integer linear programming, 2016), taken out of opencv-python-headless by",
        "//! `packaging/tools/aruco_codes.py`.",
        "",
        "/// Wrong bits that each dictionary mends: bits of a side, markers, wrong bits.",
        f"pub const MENDED: [(usize, usize, u32); {len(SIDES) * len(COUNTS)}] = [",
    ]
    for side in SIDES:
        for count in COUNTS:
            out.append(f"    ({side}, {count}, {dictionary(side, count).maxCorrectionBits}),")
    out.append("];")
    for side in SIDES:
        all_codes = list(codes(side, COUNTS[-1]))
        for count in COUNTS[:-1]:
            assert list(codes(side, count)) == all_codes[:count], (side, count)
        out += ["", f"/// Of {side}×{side} bits.", "#[rustfmt::skip]", f"pub const CODES_{side}: [u64; {COUNTS[-1]}] = ["]
        line = "   "
        for code in all_codes:
            word = f" 0x{code:x},"
            if len(line) + len(word) > 118:
                out.append(line)
                line = "   "
            line += word
        out += [line, "];"]
    return "\n".join(out) + "\n"


if __name__ == "__main__":
    if sys.argv[1:2] == ["--check"]:
        sys.exit(0 if open(sys.argv[2], encoding="utf-8").read() == table() else f"{sys.argv[2]} is not current")
    print(table(), end="")
