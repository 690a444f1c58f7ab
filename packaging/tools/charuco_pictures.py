#!/usr/bin/env python3
"""charuco_pictures.py FOLDER [--size WxH] [--count N] [--seed S]

Draws ChArUco boards by OpenCV (`CharucoBoard.generateImage`) as cameras see them: a known lens with distortion, a known
place, occluders, shade, blur, noise. Each pixel is the mean of 16 rays. Writes into FOLDER the pictures, `pictures.csv`
(picture, board, legacy), `truth.csv` (picture, id of a corner, x, y by `projectPoints`, 1 where it lies well in the
picture and nothing covers it), and `opencv.csv`, what OpenCV's own `CharucoDetector` finds in the
same files, and into `printed` boards face on. Then prints how it does. Needs opencv-python-headless; the committed folder was made with 5.0.0, by
`charuco_pictures.py tests/data/charuco`.
"""
import argparse
import csv
import pathlib

import cv2
import numpy as np

# Squares, dictionary, marker as a share of a square, legacy pattern, tilt and turn (rad), distance in board widths,
# blur (px), noise (grey levels), what covers the board, shade.
NAMED = [
    ("plain", (7, 5), "DICT_4X4_50", 0.75, False, (0.2, -0.1, 0.1), 1.15, 0.6, 2, None, 0),
    ("slant", (8, 6), "DICT_5X5_100", 0.75, False, (0.85, 0.5, -0.4), 1.0, 0.6, 2, None, 0),
    ("turned", (7, 5), "DICT_6X6_250", 0.8, False, (-0.4, 0.3, 2.9), 1.05, 0.6, 2, None, 0),
    ("hidden", (8, 6), "DICT_4X4_100", 0.75, False, (0.3, 0.3, 0.2), 1.0, 0.6, 2, "hand", 0),
    ("blurred", (7, 5), "DICT_5X5_50", 0.7, False, (0.3, -0.4, -1.3), 1.0, 1.8, 3, None, 0),
    ("smudged", (8, 6), "DICT_6X6_50", 0.75, False, (-0.2, 0.5, 0.6), 1.0, 0.8, 3, "spots", 0.6),
    ("legacy", (7, 6), "DICT_4X4_250", 0.75, True, (0.4, 0.2, -0.2), 1.0, 0.6, 2, None, 0),
    ("near", (9, 7), "DICT_5X5_250", 0.75, False, (0.3, -0.5, 0.9), 0.42, 0.6, 2, None, 0.3),
    ("far", (7, 5), "DICT_4X4_50", 0.8, False, (0.3, 0.2, 0.4), 1.9, 0.5, 2, None, 0),
]


def random_case(rng, k):
    columns, rows = int(rng.integers(5, 11)), int(rng.integers(4, 9))
    side = int(rng.integers(4, 7))
    count = next(c for c in (50, 100, 250) if c >= columns * rows // 2)
    cover = [None, None, "hand", "spots"][rng.integers(4)]
    tilt = tuple(float(v) for v in np.r_[rng.uniform(-0.8, 0.8, 2), rng.uniform(-3.1, 3.1)])
    far = float(rng.uniform(0.5, 1.6))
    return (f"r{k:03}", (columns, rows), f"DICT_{side}X{side}_{count}", float(rng.choice([0.7, 0.75, 0.8])),
            bool(rng.integers(2)), tilt, far, float(rng.uniform(0.3, 1.6)), float(rng.uniform(1, 5)), cover,
            float(rng.choice([0, 0, 0.5])))


def draw(case, size, rng):
    name, (columns, rows), dictionary, share, legacy, tilt, far, blur, noise, cover, shade = case
    board = cv2.aruco.CharucoBoard((columns, rows), 10.0, 10.0 * share,
                                   cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary)))
    board.setLegacyPattern(legacy)
    square, margin = 120, 60
    flat = board.generateImage((columns * square, rows * square), marginSize=0)
    flat = cv2.copyMakeBorder(flat, margin, margin, margin, margin, cv2.BORDER_CONSTANT, value=255)
    w, h = size
    lens = np.array([[0.95 * w, 0, w / 2 - 3.3], [0, 0.96 * w, h / 2 + 2.1], [0, 0, 1]])
    distortion = np.array([-0.22, 0.08, 0.001, -0.0007, 0.0])
    turn = cv2.Rodrigues(np.array([0, 0, tilt[2]]))[0]
    lean = cv2.Rodrigues(np.array([tilt[0], tilt[1], 0.0]))[0]
    rotation = lean @ turn
    middle = np.array([columns * 5.0, rows * 5.0, 0.0])
    reach = columns * 10.0 * far
    place = np.array([0.02 * reach, -0.01 * reach, reach]) - rotation @ middle
    # Rays of 4 x 4 places in a pixel, back to the board.
    steps = (np.arange(4) + 0.5) / 4 - 0.5
    xs = (np.arange(w)[:, None] + steps).ravel()
    ys = (np.arange(h)[:, None] + steps).ravel()
    grid = np.stack(np.meshgrid(xs, ys), -1).reshape(-1, 1, 2)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 60, 1e-12)
    rays = cv2.undistortPoints(grid, lens, distortion, criteria=criteria).reshape(-1, 2)
    rays = np.c_[rays, np.ones(len(rays))] @ rotation
    origin = -rotation.T @ place
    scale = -origin[2] / rays[:, 2]
    on = origin[:2] + rays[:, :2] * scale[:, None]
    at = (on / 10.0 * square + margin - 0.5).astype(np.float32)
    fine = cv2.remap(flat, at[:, 0].reshape(4 * h, 4 * w)[: 4 * h], at[:, 1].reshape(4 * h, 4 * w), cv2.INTER_LINEAR,
                     borderMode=cv2.BORDER_CONSTANT, borderValue=150)
    picture = 25 + 190 / 255 * fine.reshape(h, 4, w, 4).mean((1, 3))
    covered = np.zeros((h, w), bool)
    corners = board.getChessboardCorners().reshape(-1, 3)
    seen = cv2.projectPoints(corners, cv2.Rodrigues(rotation)[0], place, lens, distortion)[0].reshape(-1, 2)
    yy, xx = np.mgrid[:h, :w]
    if cover == "hand":
        c = seen[rng.integers(len(seen))]
        covered |= np.hypot(xx - c[0] - 20, (yy - c[1]) * 1.4) < 0.17 * w
        picture[covered] = 110 + 25 * np.sin(xx / 9.0)[covered]
    elif cover == "spots":
        for _ in range(9):
            x, y = seen[rng.integers(len(seen))] + rng.normal(0, 12, 2)
            spot = np.hypot(xx - x, yy - y) < rng.uniform(5, 11)
            covered |= spot
            picture[spot] = rng.uniform(20, 220)
    if shade:
        picture *= 1 - shade * np.clip((xx + 0.5 * yy) / (w + 0.5 * h), 0, 1)
    picture = cv2.GaussianBlur(picture, (0, 0), blur) + rng.normal(0, noise, picture.shape)
    near_cover = cv2.dilate(covered.astype(np.uint8), np.ones((7, 7))) > 0
    kept = [(i, x, y, int(4 <= x <= w - 5 and 4 <= y <= h - 5 and not near_cover[int(round(y)), int(round(x))]))
            for i, (x, y) in enumerate(seen)]
    spec = f"{columns}x{rows},10,{10 * share:g},{dictionary}"
    return board, np.clip(np.round(picture), 0, 255).astype(np.uint8), spec, kept


def printed(folder):
    """Boards face on, a pixel for each bit of a marker."""
    folder.mkdir(exist_ok=True)
    for name, size, share, side, dictionary, legacy in [("plain", (7, 5), 0.75, 8, "DICT_4X4_50", False),
                                                        ("legacy", (7, 6), 0.75, 8, "DICT_4X4_100", True),
                                                        ("six", (5, 4), 0.8, 10, "DICT_6X6_250", False)]:
        board = cv2.aruco.CharucoBoard(size, 10.0, 10.0 * share,
                                       cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary)))
        board.setLegacyPattern(legacy)
        cv2.imwrite(str(folder / f"{name}.png"), board.generateImage((size[0] * side, size[1] * side), marginSize=0))


def main():
    args = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    args.add_argument("folder", type=pathlib.Path)
    args.add_argument("--size", default="480x360")
    args.add_argument("--count", type=int, default=0, help="random boards instead of the named ones")
    args.add_argument("--seed", type=int, default=1)
    args = args.parse_args()
    size = tuple(int(v) for v in args.size.split("x"))
    rng = np.random.default_rng(args.seed)
    cases = [random_case(rng, k) for k in range(args.count)] or NAMED
    args.folder.mkdir(parents=True, exist_ok=True)
    files = {n: csv.writer((args.folder / f"{n}.csv").open("w", newline=""), lineterminator="\n")
             for n in ("pictures", "truth", "opencv")}
    files["pictures"].writerow(["picture", "columns", "rows", "square", "marker", "dictionary", "legacy"])
    for n in ("truth", "opencv"):
        files[n].writerow(["picture", "id", "x", "y"] + ["clear"] * (n == "truth"))
    if not args.count:
        printed(args.folder / "printed")
    total, found_all, squares, wrong = 0, 0, [], 0
    for case in cases:
        board, picture, spec, truth = draw(case, size, rng)
        name = f"{case[0]}.png"
        cv2.imwrite(str(args.folder / name), picture, [cv2.IMWRITE_PNG_COMPRESSION, 9])
        grid, *rest = spec.split(",")
        files["pictures"].writerow([name, *grid.split("x"), *rest, int(case[4])])
        corners, ids, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(picture)
        by_id = {i: np.array([x, y]) for i, x, y, _ in truth}
        clear = {i for i, _, _, clear in truth if clear}
        files["truth"].writerows([name, i, f"{x:.4f}", f"{y:.4f}", clear] for i, x, y, clear in truth)
        hits = [] if ids is None else list(zip(ids.ravel().tolist(), corners.reshape(-1, 2)))
        files["opencv"].writerows([name, i, f"{x:.4f}", f"{y:.4f}"] for i, (x, y) in hits)
        off = {i: np.linalg.norm(p - by_id[i]) for i, p in hits}
        good = [d for i, d in off.items() if d < 2 and i in clear]
        bad = sum(d >= 2 for d in off.values())
        wrong += bad
        total, found_all = total + len(clear), found_all + len(good)
        squares += [d * d for d in good]
        rms = np.sqrt(np.mean(np.square(good))) if good else float("nan")
        print(f"{name}: OpenCV found {len(good)} of {len(clear)}, rms {rms:.3f} px, {bad} off by 2 px")
    print(f"all: {found_all} of {total}, rms {np.sqrt(np.mean(squares)):.3f} px, {wrong} off by 2 px")


if __name__ == "__main__":
    main()
