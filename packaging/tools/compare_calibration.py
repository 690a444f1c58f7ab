#!/usr/bin/env python3
"""compare_calibration.py [--vitreo PROGRAM] [--from SEED] [--rigs N]

Makes rigs by seed (lenses, places of three cameras, a board, a stepped target of dots, noise, hidden points), calibrates
each by `vitreo calibrate intrinsics`, `stereo` and `dots` and by OpenCV on the same points, and judges both by the same
code on what took no part: every second view of the board, a random half of the dots. Points are projected by OpenCV.
PROGRAM is vitreo or vitreo-calibration. Needs numpy and opencv-python-headless. Prints a table in Markdown.

lens    focal lengths beside the truth (rms of fx and fy, %), and what is left of board views that took no part, the
        board laid where it fits best, px
stereo  corners of those views triangulated, laid over the board view by view, rms um
dots    dots that took no part, triangulated, rms um in x / y / z, lenses found from the dots alone

OpenCV: calibrateCamera with k1 k2 p1 p2 k3; stereoCalibrate of cameras 0 and 1, 0 and 2, lenses held; for dots
calibrateCamera from the focal length by which the board's lens was drawn, off by 5 %, and the picture's middle.
"""
import argparse
import json
import pathlib
import subprocess
import tempfile

import cv2
import numpy as np

SIZES = [(640, 480), (720, 576), (720, 480)]
TIGHT = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 500, 1e-12)


def rotation(vector):
    return cv2.Rodrigues(np.asarray(vector, float))[0]


class Rig:
    def __init__(self, seed):
        rng = np.random.default_rng(seed)
        self.rng, self.size = rng, SIZES[rng.integers(3)]
        w, h = self.size
        self.noise = float(rng.choice([0.05, 0.1, 0.2]))
        self.pitch = 2.5
        self.grid = (int(rng.integers(7, 11)), int(rng.integers(5, 9)))
        self.cameras = []
        for c in range(3):
            f = rng.uniform(1.1, 2.2) * w
            matrix = np.array([[f, 0, w / 2 + rng.normal(0, 0.02 * w)],
                               [0, f * rng.uniform(0.98, 1.1), h / 2 + rng.normal(0, 0.02 * h)], [0, 0, 1]])
            lens = np.r_[rng.uniform(-0.3, 0.1), rng.uniform(-0.1, 0.2), rng.normal(0, 5e-4, 2), 0.0]
            far = 1.25 * self.pitch * self.grid[0] * f / w * rng.uniform(1.0, 1.3)
            turn = rotation([0.25 * rng.normal(), (c - 1) * rng.uniform(0.35, 0.6), 0.2 * rng.normal()])
            self.cameras.append((matrix, lens, turn, np.array([0, 0, far])))
        n, m = self.grid
        self.board = np.array([[i * self.pitch, j * self.pitch, 0] for j in range(m) for i in range(n)])
        middle = self.board.mean(0)
        self.views = []
        for _ in range(24):
            turn = rotation(np.r_[rng.uniform(-0.6, 0.6, 2), rng.uniform(-0.5, 0.5)])
            reach = self.pitch * n
            self.views.append((turn, rng.uniform(-0.25, 0.25, 3) * reach - turn @ middle))
        steps = np.array([[x, y, 3.0 * ((x // 4) % 3)] for x in range(13) for y in range(11)], float)
        self.dots = (steps * [1, 1, 1.5] - [6, 5, 4.5]) * (self.pitch * n / 14)

    def seen(self, c, points):
        """Pixels with noise, and which of them are in the picture and not hidden."""
        matrix, lens, turn, place = self.cameras[c]
        exact = cv2.projectPoints(points, cv2.Rodrigues(turn)[0], place, matrix, lens)[0].reshape(-1, 2)
        noisy = exact + self.rng.normal(0, self.noise, exact.shape)
        inside = ((exact > 1) & (exact < np.array(self.size) - 2)).all(1)
        return noisy, inside & (self.rng.random(len(points)) > 0.05)


def triangulated(cameras, pixels):
    """The point whose images are nearest to the pixels, by Gauss-Newton."""
    rows = []
    for (matrix, lens, turn, place), pixel in zip(cameras, pixels):
        u = cv2.undistortPoints(pixel.reshape(1, 1, 2), matrix, lens, criteria=TIGHT).ravel()
        p = np.c_[turn, place]
        rows += [u[0] * p[2] - p[0], u[1] * p[2] - p[1]]
    x = np.linalg.svd(np.array(rows))[2][-1]
    x = x[:3] / x[3]

    def left(x):
        return np.concatenate([
            cv2.projectPoints(x.reshape(1, 3), cv2.Rodrigues(r)[0], t, k, d)[0].ravel() - p
            for (k, d, r, t), p in zip(cameras, pixels)])

    for _ in range(4):
        r = left(x)
        j = np.stack([(left(x + step) - r) / 1e-4 for step in 1e-4 * np.eye(3)], 1)
        x = x - np.linalg.lstsq(j, r, rcond=None)[0]
    return x


def laid_over(points, board):
    a, b = points - points.mean(0), board - board.mean(0)
    u, _, v = np.linalg.svd(b.T @ a)
    turn = u @ np.diag([1, 1, np.sign(np.linalg.det(u @ v))]) @ v
    return a - b @ turn


class Vitreo:
    def __init__(self, program):
        self.program = [program] + (["calibrate"] if pathlib.Path(program).name == "vitreo" else [])

    def run(self, *words):
        done = subprocess.run([*self.program, *map(str, words)], capture_output=True, text=True)
        if done.returncode:
            raise RuntimeError(f"{' '.join(map(str, words))}: {done.stderr}")

    @staticmethod
    def camera(c):
        matrix = np.array([[c["fx"], 0, c["cx"]], [0, c["fy"], c["cy"]], [0, 0, 1]])
        return matrix, np.array(c["dist"]), np.array(c["R"] if "R" in c else c["rotation"]), np.array(c["t"])


def write(path, views):
    lines = ["x,y,X,Y,Z,view"]
    for name, pixels, points in views:
        lines += [",".join([*(f"{v:.9f}" for v in (*p, *q)), str(name)]) for p, q in zip(pixels, points)]
    path.write_text("\n".join(lines) + "\n")
    return path


def one(seed, vitreo, folder):
    rig = Rig(seed)
    w, h = rig.size
    size = f"{w}x{h}"
    out = {"lens": [[], []], "left": [[], []], "stereo": [[], []], "dots": [[], []]}
    shots = [[rig.seen(c, rig.board @ r.T + t) for r, t in rig.views] for c in range(3)]
    usable = [[v for v in range(len(rig.views)) if shots[c][v][1].sum() >= 12] for c in range(3)]
    learn = [[v for v in u if v % 2 == 0] for u in usable]
    theirs, lists = [], []
    for c in range(3):
        views = [(v, shots[c][v][0][shots[c][v][1]], rig.board[shots[c][v][1]]) for v in learn[c]]
        lists.append(write(folder / f"c{c}.csv", views))
        vitreo.run("intrinsics", "--points", lists[c], "--size", size, "-o", folder / f"lens{c}.json", "--force")
        own = Vitreo.camera(json.loads((folder / f"lens{c}.json").read_text()))[:2]
        _, matrix, lens, *_ = cv2.calibrateCamera([np.float32(p) for _, _, p in views], [np.float32(p) for _, p, _ in views],
                                                  rig.size, None, None, criteria=TIGHT)
        theirs.append((matrix, lens.ravel()))
        for k, (matrix, lens) in enumerate([own, theirs[c]]):
            truth = rig.cameras[c][0]
            out["lens"][k] += [(matrix[i, i] / truth[i, i] - 1) * 100 for i in (0, 1)]
            for v in (v for v in usable[c] if v % 2):
                pixels, kept = shots[c][v]
                pixels, points = pixels[kept], rig.board[kept]
                _, r, t = cv2.solvePnP(points, pixels, matrix, lens)
                r, t = cv2.solvePnPRefineLM(points, pixels, matrix, lens, r, t)
                out["left"][k] += list((cv2.projectPoints(points, r, t, matrix, lens)[0].reshape(-1, 2) - pixels).ravel())
    vitreo.run("stereo", "--points", *lists, "--size", size, "-o", folder / "stereo.json", "--force")
    own = [Vitreo.camera(c) for c in json.loads((folder / "stereo.json").read_text())["cameras"]]
    pair = [(*theirs[0], np.eye(3), np.zeros(3))]
    for c in (1, 2):
        both = [v for v in learn[0] if v in learn[c] and (shots[0][v][1] & shots[c][v][1]).sum() >= 12]
        kept = [shots[0][v][1] & shots[c][v][1] for v in both]
        _, _, _, m, d, r, t, *_ = cv2.stereoCalibrate(
            [np.float32(rig.board[k]) for k in kept], [np.float32(shots[0][v][0][k]) for v, k in zip(both, kept)],
            [np.float32(shots[c][v][0][k]) for v, k in zip(both, kept)], *theirs[0], *theirs[c], rig.size,
            flags=cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_INTRINSIC, criteria=TIGHT)
        pair.append((m, d.ravel(), r, t.ravel()))
    for k, cameras in enumerate([own, pair]):
        for v in range(1, len(rig.views), 2):
            kept = np.flatnonzero(shots[0][v][1] & shots[1][v][1] & shots[2][v][1])
            if len(kept) < 12:
                continue
            found = np.array([triangulated(cameras, [shots[c][v][0][i] for c in range(3)]) for i in kept])
            out["stereo"][k] += list(1e3 * np.linalg.norm(laid_over(found, rig.board[kept]), axis=1))
    sight = [rig.seen(c, rig.dots) for c in range(3)]
    half = rig.rng.random(len(rig.dots)) < 0.5
    files = [write(folder / f"d{c}.csv", [("", p[k & half], rig.dots[k & half])]) for c, (p, k) in enumerate(sight)]
    files = [f for f in files if f.write_text("\n".join(line.rsplit(",", 1)[0] for line in f.read_text().split("\n")))]
    vitreo.run("dots", "--size", size, *files, "-o", folder / "dots.json", "--force")
    own = [Vitreo.camera(c) for c in json.loads((folder / "dots.json").read_text())["cameras"]]
    cv = []
    for c, (p, k) in enumerate(sight):
        f = 1.05 * rig.cameras[c][0][0, 0]
        guess = np.array([[f, 0, w / 2], [0, f, h / 2], [0, 0, 1.0]])
        _, matrix, lens, r, t = cv2.calibrateCamera([np.float32(rig.dots[k & half])], [np.float32(p[k & half])], rig.size,
                                                    guess, None, flags=cv2.CALIB_USE_INTRINSIC_GUESS, criteria=TIGHT)
        cv.append((matrix, lens.ravel(), rotation(r[0]), t[0].ravel()))
    kept = np.flatnonzero(sight[0][1] & sight[1][1] & sight[2][1] & ~half)
    for k, cameras in enumerate([own, cv]):
        out["dots"][k] = [1e3 * (triangulated(cameras, [sight[c][0][i] for c in range(3)]) - rig.dots[i]) for i in kept]
    return rig, out


def rms(values):
    return np.sqrt(np.mean(np.square(values)))


def main():
    args = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    args.add_argument("--vitreo", default="target/release/vitreo")
    args.add_argument("--from", dest="first", type=int, default=1001)
    args.add_argument("--rigs", type=int, default=8)
    args = args.parse_args()
    vitreo = Vitreo(args.vitreo)
    print("| seed | pictures, noise | focal lengths off by, % | left of views that took no part, px | corners, µm | dots, µm |")
    print("|---|---|---|---|---|---|")
    every = []
    for seed in range(args.first, args.first + args.rigs):
        with tempfile.TemporaryDirectory() as folder:
            rig, out = one(seed, vitreo, pathlib.Path(folder))
        row = []
        for k in (0, 1):
            row.append([rms(out["lens"][k]), rms(out["left"][k]), rms(out["stereo"][k]),
                        *np.sqrt(np.mean(np.square(out["dots"][k]), 0))])
        every.append(row)
        line(f"{seed}", f"{rig.size[0]}×{rig.size[1]}, {rig.noise}", row)
    line("median", "", np.median(np.array(every), 0))


def line(name, what, row):
    (a, b, c, *d), (e, f, g, *i) = row
    three = [" / ".join(f"{v:.1f}" for v in x) for x in (d, i)]
    print(f"| {name} | {what} | {a:.3f}, {e:.3f} | {b:.4f}, {f:.4f} | {c:.2f}, {g:.2f} | {three[0]}, {three[1]} |", flush=True)


if __name__ == "__main__":
    main()
