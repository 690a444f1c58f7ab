#!/usr/bin/env python3
"""compare_blobs.py DATA [--vitreo PATH] [--markdown]

Runs `vitreo blobs` and two extractors of OpenCV on the same real pictures and prints what each found and how far
apart the centres of the same blobs are. DATA is the folder with `opencv`, `myptv`, `tetra3_stars` and
`trackpy_bulk_water` in it. Needs numpy and opencv-python-headless.

The three see the same pixels: luma in the studio range, minus a background (a constant, or for OpenCV a median over
65 x 65 px where vitreo tracks it), dark turned to bright where blobs are dark.

cc      connectedComponentsWithStats of the pixels above the low threshold, 8-connected, kept where the brightest pixel is
        above the high threshold and the area large enough; its centre counts every pixel alike
weights the same components, pixels weighted by what they are above the background
simple  SimpleBlobDetector over the same range of thresholds, with its other filters off

"same" counts vitreo's blobs whose centre lies within 3 px of one of the other's; distances are over well-separated
blobs: no other one's box within 6 px, no second centre within 8 px, off the border, not flagged as merged.

Two extractors may agree and both be wrong: for spots of light the second table gives distances to a Gaussian fitted
to the samples of the file around each of vitreo's well-separated spots (needs scipy).
"""
import argparse
import json
import pathlib
import subprocess
import sys
import time

import cv2
import numpy as np

LOOSE_PX, GAP_PX, CROWD_PX, FIT_PX = 3.0, 6.0, 8.0, 4
# name, pictures, fixed background or None, low, high, least area, dark, spots
CASES = [
    ("detect_blob", ["opencv/detect_blob.png"], 16, 10, 20, 30, False, False),
    ("smarties", ["opencv/smarties.png"], 16, 40, 60, 40, True, False),
    ("dot target", [f"myptv/Calibration/cal{i}.png" for i in (1, 2, 3)], None, 16, 32, 4, False, True),
    ("particles", [f"myptv/Images_cam{c}/0{i}.png" for c in (1, 2, 3) for i in (1, 2, 3)], None, 12, 24, 3, False, True),
    ("beads", [f"trackpy_bulk_water/bulk_water_00{i}.png" for i in range(6)], None, 12, 24, 6, True, True),
    ("stars", ["tetra3_stars/2019-07-29T204726_Alt40_Azi-135_Try1.png",
               "tetra3_stars/2019-07-29T204726_Alt40_Azi135_Try1.png"], None, 12, 24, 3, False, True),
]


def luma(path, dark):
    """Luma as vitreo makes it: studio range, samples of 16 bits from their 1 % quantile up."""
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if image.dtype == np.uint16:
        low, high, most = np.percentile(image, [1, 99, 100], method="higher").astype(int)
        white = min(low + 8 * max(high - low, 1), most)
        image = ((np.clip(image.astype(int), low, white) - low) * 255 + (white - low) // 2) // (white - low)
    if image.ndim == 3:
        b, g, r = (image[..., i].astype(int) for i in range(3))
        y = ((16829 * r + 33039 * g + 6416 * b + 32768) >> 16) + 16
    else:
        y = (image.astype(int) * 219 + 127) // 255 + 16
    return (251 - y if dark else y).astype(np.uint8)


def components(y, ground, low, high, least_area):
    """Centres by area, centres by weight and boxes (left, top, right, bottom) of OpenCV's components."""
    above = y.astype(np.int16) - ground
    count, labels, stats, centres = cv2.connectedComponentsWithStats((above >= low).astype(np.uint8), connectivity=8)
    flat, weight = labels.ravel(), np.maximum(above, 0).ravel().astype(float)
    peak = np.zeros(count)
    np.maximum.at(peak, flat, weight)
    rows, columns = np.divmod(np.arange(flat.size), y.shape[1])
    total = np.maximum(np.bincount(flat, weight, count), 1e-9)
    weighted = np.stack([np.bincount(flat, weight * columns, count), np.bincount(flat, weight * rows, count)], 1)
    kept = (peak >= high) & (stats[:, cv2.CC_STAT_AREA] >= least_area)
    kept[0] = False
    left, top, width, height = (stats[kept, i] for i in range(4))
    boxes = np.stack([left, top, left + width - 1, top + height - 1], 1)
    return centres[kept], (weighted / total[:, None])[kept], boxes


def simple(y, ground, low, high, least_area):
    """Centres of SimpleBlobDetector."""
    p = cv2.SimpleBlobDetector_Params()
    p.filterByColor, p.blobColor = True, 255
    p.filterByArea, p.minArea, p.maxArea = True, float(least_area), float(y.size)
    p.filterByCircularity = p.filterByConvexity = p.filterByInertia = False
    p.minThreshold, p.maxThreshold, p.thresholdStep = low, 200, 10
    p.minRepeatability, p.minDistBetweenBlobs = 1, 1
    above = np.clip(y.astype(np.int16) - ground, 0, 255).astype(np.uint8)
    return np.array([k.pt for k in cv2.SimpleBlobDetector_create(p).detect(above)]).reshape(-1, 2)


def ours(vitreo, paths, case):
    """Blobs of vitreo, one array of (x, y, width, height, flags) a picture, and the time it took, s."""
    _, _, ground, low, high, least_area, dark, spots = case
    # The area of a spot is the sum of its weights, less than the number of its pixels.
    least_area = 1 if spots else least_area
    background = "tracked" if ground is None else f"fixed={ground}"
    command = [vitreo, "blobs", "--grey", "--background", background, "--threshold", f"{low}:{high}",
               "--min-area", str(least_area), "--polarity", "dark" if dark else "bright", *(["--spots"] if spots else []), *map(str, paths)]
    began = time.perf_counter()
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    spent = time.perf_counter() - began
    rows = [[(b["x"], b["y"], b["w"], b["h"], b.get("flags", 0)) for b in json.loads(line)["blobs"]]
            for line in done.stdout.splitlines()]
    return [np.array(r).reshape(-1, 5) for r in rows], spent


def nearest(a, b):
    """For each point of a, the index of the nearest of b and its distance."""
    if not len(a) or not len(b):
        return np.zeros(len(a), int), np.full(len(a), np.inf)
    d = np.hypot(a[:, None, 0] - b[None, :, 0], a[:, None, 1] - b[None, :, 1])
    return d.argmin(1), d.min(1)


def alone(blobs, shape):
    """Which of vitreo's blobs are well separated."""
    if not len(blobs):
        return np.zeros(0, bool)
    centre, half = blobs[:, :2], blobs[:, 2:4] / 2
    gap = (np.abs(centre[:, None] - centre[None]) - half[:, None] - half[None]).max(2)
    np.fill_diagonal(gap, np.inf)
    # What frames the picture has everything in its box.
    gap[:, (blobs[:, 2:4] > np.array(shape[::-1]) / 2).all(1)] = np.inf
    inside = (centre - half > 2).all(1) & (centre + half < np.array(shape[::-1]) - 3).all(1)
    return (gap.min(1) > GAP_PX) & inside & (blobs[:, 4].astype(int) & 3 == 0)


def fitted(samples, x, y):
    """Centre of a Gaussian on a level ground, fitted to the samples around (x, y); None where it does not fit."""
    from scipy.optimize import least_squares
    r, cx, cy = FIT_PX, round(x), round(y)
    window = samples[cy - r:cy + r + 1, cx - r:cx + r + 1].astype(float)
    if window.shape != (2 * r + 1, 2 * r + 1):
        return None
    gy, gx = np.mgrid[-r:r + 1, -r:r + 1]
    ground = np.median(window)

    def rest(p):
        dx, dy = (gx - p[1]) / p[3], (gy - p[2]) / p[4]
        return (p[5] + p[0] * np.exp(np.minimum(-0.5 * (dx * dx + dy * dy), 0)) - window).ravel()

    height = window[r - 1:r + 2, r - 1:r + 2].mean() - ground
    p = least_squares(rest, [height, x - cx, y - cy, 1.2, 1.2, ground]).x
    good = np.hypot(p[1], p[2]) < 2 and all(0.4 < abs(s) < 3 for s in p[3:5]) and p[0] * height > 0
    return np.array([cx + p[1], cy + p[2]]) if good else None


def compare(vitreo, data, case):
    name, files, ground, low, high, least_area, dark, spots = case
    paths = [data / f for f in files]
    found, ours_s = ours(vitreo, paths, case)
    row = {"name": name, "pictures": len(paths), "vitreo": sum(map(len, found)), "vitreo_s": ours_s}
    distances = {"cc": [], "weights": [], "simple": []}
    counts, same, spent = dict.fromkeys(distances, 0), dict.fromkeys(distances, 0), dict.fromkeys(distances, 0.0)
    to_fit = {"vitreo": [], **{kind: [] for kind in distances}}
    for path, blobs in zip(paths, found):
        y = luma(path, dark)
        level = np.int16(ground) if ground is not None else cv2.medianBlur(y, 65).astype(np.int16)
        began = time.perf_counter()
        cc, weights, _ = components(y, level, low, high, least_area)
        spent["cc"] += time.perf_counter() - began
        began = time.perf_counter()
        keypoints = simple(y, level, low, high, least_area)
        spent["simple"] += time.perf_counter() - began
        lonely = alone(blobs, y.shape)
        if spots:
            deep = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
            samples = deep if deep.dtype == np.uint16 else y
            truths = [t for b in blobs[lonely] if (t := fitted(samples, b[0], b[1])) is not None]
            for kind, centres in (("vitreo", blobs[:, :2]), ("cc", cc), ("weights", weights), ("simple", keypoints)):
                _, d = nearest(np.array(truths).reshape(-1, 2), centres)
                to_fit[kind] += list(d[d < LOOSE_PX])
        for kind, centres in (("cc", cc), ("weights", weights), ("simple", keypoints)):
            counts[kind] += len(centres)
            _, d = nearest(blobs[:, :2], centres)
            same[kind] += int((d < LOOSE_PX).sum())
            # No other detector's second blob may be near either.
            crowd = (np.hypot(*(blobs[:, None, :2] - centres[None]).transpose(2, 0, 1)) < CROWD_PX).sum(1)
            distances[kind] += list(d[lonely & (d < LOOSE_PX) & (crowd == 1)])
    row["fit"] = {k: (np.median(d), np.percentile(d, 95), len(d)) for k, d in to_fit.items() if d}
    for kind in distances:
        d = np.array(distances[kind]) if distances[kind] else np.array([np.nan])
        row[kind] = (counts[kind], same[kind], len(distances[kind]), np.median(d), np.percentile(d, 95))
    row["cc_s"], row["simple_s"] = spent["cc"], spent["simple"]
    return row


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[1])
    parser.add_argument("data", type=pathlib.Path)
    parser.add_argument("--vitreo", default="target/release/vitreo")
    args = parser.parse_args()
    if not (args.data / "opencv").is_dir():
        sys.exit(f"{args.data}: expected a folder with opencv, myptv, … in it")
    print(f"OpenCV {cv2.__version__}; distances in px: median / 95 % over n well-separated blobs; times in ms, all pictures\n")
    head = ["pictures", "n", "vitreo", "cc", "same", "vitreo–cc", "vitreo–weights", "simple", "same", "vitreo–simple",
            "ms vitreo, cc, simple"]
    print("| " + " | ".join(head) + " |\n|" + "---|" * len(head))
    rows = [compare(args.vitreo, args.data, case) for case in CASES]
    for r in rows:
        apart = {k: f"{r[k][3]:.3f} / {r[k][4]:.3f} ({r[k][2]})" for k in ("cc", "weights", "simple")}
        times = ", ".join(f"{1e3 * r[k]:.0f}" for k in ("vitreo_s", "cc_s", "simple_s"))
        print(f"| {r['name']} | {r['pictures']} | {r['vitreo']} | {r['cc'][0]} | {r['cc'][1]} | {apart['cc']} | {apart['weights']} "
              f"| {r['simple'][0]} | {r['simple'][1]} | {apart['simple']} | {times} |")
    print("\nDistance to a fitted Gaussian, px: median / 95 % (n)\n\n| pictures | vitreo | cc | weights | simple |\n|---|---|---|---|---|")
    for r in rows:
        if r["fit"]:
            cells = (r["fit"].get(k) for k in ("vitreo", "cc", "weights", "simple"))
            print(f"| {r['name']} | " + " | ".join(f"{c[0]:.3f} / {c[1]:.3f} ({c[2]})" if c else "–" for c in cells) + " |")


if __name__ == "__main__":
    main()
