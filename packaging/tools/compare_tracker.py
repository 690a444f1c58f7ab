#!/usr/bin/env python3
"""The tracker beside OpenCV on the same fields, in one run: accuracy of the tip and time per body and field triple.

    python3 packaging/tools/compare_tracker.py [--stream DIR] [--json]

OpenCV is given which blob is which marker (it cannot find out); the tracker finds out by itself. Its methods:
  triangulate          cv2.undistortImagePoints, cv2.triangulatePoints of the first two cameras, rigid fit (Kabsch)
  triangulate + refine the same as a start, then all cameras' pixels: Levenberg-Marquardt over cv2.projectPoints
Times of OpenCV include Python's share, a few microseconds a call. Needs numpy, scipy, opencv-python-headless and cargo.
The stream's folder holds rig.json, blobs.jsonl and truth.csv with tips at the exposures, as tests/data/tracker does.
"""
import argparse
import csv
import json
import os
import subprocess
import sys
import tempfile
import time

import cv2
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

ROOT = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "..")
GATE_PX = 3.0
SETTLE_S = 0.3


def camera_matrices(camera):
    k = np.array([[camera["fx"], 0, camera["cx"]], [0, camera["fy"], camera["cy"]], [0, 0, 1.0]])
    return k, np.array(camera["dist"]), np.array(camera["R"]), np.array(camera["t"])


def project(points, camera):
    k, dist, r, t = camera_matrices(camera)
    return cv2.projectPoints(points, cv2.Rodrigues(r)[0], t, k, dist)[0].reshape(-1, 2)


def triangulate(pixels, cameras):
    """Points in the world from the first two cameras that see them."""
    rays, matrices = [], []
    for px, camera in zip(pixels[:2], cameras[:2]):
        k, dist, r, t = camera_matrices(camera)
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-12)
        straight = cv2.undistortImagePoints(px.reshape(-1, 1, 2), k, dist, None, criteria).reshape(-1, 2)
        rays.append(((straight - k[:2, 2]) / np.diag(k)[:2]).T)
        matrices.append(np.hstack([r, t[:, None]]))
    points = cv2.triangulatePoints(matrices[0], matrices[1], rays[0], rays[1])
    return (points[:3] / points[3]).T


def rigid_fit(markers, points):
    a, b = markers.mean(0), points.mean(0)
    u, _, vt = np.linalg.svd((markers - a).T @ (points - b))
    r = vt.T @ np.diag([1, 1, np.sign(np.linalg.det(vt.T @ u.T))]) @ u.T
    return r, b - r @ a


def refine(r, t, markers, pixels, cameras):
    def residuals(x):
        points = Rotation.from_rotvec(x[:3]).apply(markers) + x[3:]
        return np.concatenate([((p - project(points, c)) * [20.0, 10.0]).ravel() for p, c in zip(pixels, cameras)])

    start = np.concatenate([Rotation.from_matrix(r).as_rotvec(), t])
    x = least_squares(residuals, start, method="lm", xtol=1e-10).x
    return Rotation.from_rotvec(x[:3]).as_matrix(), x[3:]


def matched(body, fields, cameras, tip, own):
    """Pixels of all markers in every camera, if each is seen by itself near where the tracker's own pose puts it."""
    points = own.apply(np.array([m["p"] for m in body["markers"]])) + tip
    pixels = []
    for camera in cameras:
        field = fields[camera["id"]]
        found = []
        for marker, image in zip(body["markers"], project(points, camera)):
            blobs = [[b["x"], 2 * b["y"] + field["parity"]] for b in field["blobs"] if b["colour"] == marker["colour"]]
            near = [b for b in blobs if np.hypot(*(np.array(b) - image)) < GATE_PX]
            if len(near) != 1:
                return None
            found.append(near[0])
        pixels.append(np.array(found))
    return pixels


def run_tracker(stream):
    with tempfile.TemporaryDirectory() as folder:
        out = os.path.join(folder, "poses.csv")
        files = [os.path.join(stream, "rig.json"), os.path.join(stream, "blobs.jsonl"), out]
        example = ["cargo", "run", "--release", "-q", "-p", "tracker", "--example", "poses", "--", *files]
        subprocess.run(example, cwd=ROOT, check=True, stderr=subprocess.DEVNULL)
        poses = {}
        for row in csv.DictReader(open(out)):
            if row["kind"] == "meas" and row["valid"] == "1" and row["body"] != "eye":
                tip = np.array([float(row[k]) for k in "xyz"])
                poses[row["body"], int(row["t_ns"])] = tip, Rotation.from_quat([float(row["q" + k]) for k in "xyzw"])
    bench = ["cargo", "bench", "-q", "-p", "tracker", "--bench", "field", "--", "--json"]
    lines = subprocess.run(bench, cwd=ROOT, check=True, capture_output=True, text=True).stdout.splitlines()
    return poses, [json.loads(line) for line in lines if line.startswith("{")]


def read_truth(stream):
    """Tips by instant: columns t_ns, then x, y, z of inst0 and of inst1."""
    rows = np.loadtxt(os.path.join(stream, "truth.csv"), delimiter=",", skiprows=1)
    return {int(r[0]): {"inst0": r[1:4], "inst1": r[4:7]} for r in rows}


def main():
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--stream", default=os.path.join(ROOT, "tests/data/tracker/nominal"))
    arguments.add_argument("--json", action="store_true")
    options = arguments.parse_args()
    cv2.setNumThreads(1)
    rig = json.load(open(os.path.join(options.stream, "rig.json")))
    bodies = {b["name"]: b for b in rig["bodies"]}
    triples = {}
    for line in open(os.path.join(options.stream, "blobs.jsonl")):
        field = json.loads(line)
        triples.setdefault(field["seq"], {})[field["cam"]] = field
    poses, bench = run_tracker(options.stream)
    truth = read_truth(options.stream)
    first = min(t for _, t in poses)
    errors = {"triangulate": [], "triangulate + refine": [], "tracker": []}
    times = {"triangulate": [], "triangulate + refine": []}
    for fields in triples.values():
        reference = fields.get(rig["cameras"][0]["id"])
        if reference is None or len(fields) < len(rig["cameras"]) or reference["t_ns"] not in truth:
            continue
        at = reference["t_ns"]
        for name in ("inst0", "inst1"):
            if (name, at) not in poses or at - first < SETTLE_S * 1e9:
                continue
            tip, turn = poses[name, at]
            pixels = matched(bodies[name], fields, rig["cameras"], tip, turn)
            if pixels is None:
                continue
            markers = np.array([m["p"] for m in bodies[name]["markers"]])
            begin = time.perf_counter()
            r, t = rigid_fit(markers, triangulate(pixels, rig["cameras"]))
            middle = time.perf_counter()
            _, t2 = refine(r, t, markers, pixels, rig["cameras"])
            end = time.perf_counter()
            times["triangulate"].append(middle - begin)
            times["triangulate + refine"].append(end - begin)
            for way, found in (("triangulate", t), ("triangulate + refine", t2), ("tracker", tip)):
                errors[way].append(np.linalg.norm(found - truth[at][name]) * 1e3)
    rows = [
        dict(method=way, per="body and triple", tip_rms_um=float(np.sqrt(np.mean(np.square(errors[way])))),
             median_us=float(np.median(times[way]) * 1e6), max_us=float(np.max(times[way]) * 1e6), poses=len(errors[way]))
        for way in times
    ]
    rows.append(dict(method="tracker", per="frame: eye and two instruments, matching, filter, prediction",
                     tip_rms_um=float(np.sqrt(np.mean(np.square(errors["tracker"])))), median_us=bench[0]["median_us"],
                     max_us=bench[0]["max_us"], poses=len(errors["tracker"])))
    for row in rows:
        if options.json:
            print(json.dumps(row))
        else:
            print(f"{row['method']:22} tip RMS {row['tip_rms_um']:6.2f} µm   median {row['median_us']:8.1f} µs   max {row['max_us']:8.1f} µs   ({row['poses']} poses; per {row['per']})")


if __name__ == "__main__":
    sys.exit(main())
