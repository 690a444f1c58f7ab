#!/usr/bin/env python3
"""igtl_client.py VITREO FILE.mcap [SECONDS]: six transforms at 200 Hz through pyigtl, compared with the recording.

Starts a simulator at 200 Hz and a bridge, receives with pyigtl, then compares every transform with the
recorded pose of its field, bit for bit in 32-bit floats. Prints how many were compared, the rate of each and
what the bridge cost: user and system time of /proc/PID/stat from the first transform to the end. Exit
code 1 where something is wrong.
"""

import os
import socket
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pyigtl
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

ROOT = Path(__file__).resolve().parents[2]
SECONDS = 12
BODIES = {"Instrument0ToWorld": 0, "Instrument1ToWorld": 1, "EyeToWorld": 2}
NAMES = [*BODIES, "Instrument0ToEye", "Instrument1ToEye", "WorldToEye"]
# It is 0.8 % on a virtual machine, and was 2.5 % beside two busy cores (docs/bridge.md).
MOST_CPU = 0.05


def require(holds, message):
    if not holds:
        raise SystemExit(f"igtl_client: {message}")


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def cpu_s(pid):
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def receive(port, run, bridge):
    """Transforms by name and field, while the simulator runs; and the bridge's share of a core."""
    client, heard, last = pyigtl.OpenIGTLinkClient("127.0.0.1", port), {}, {}
    began = None
    while run.poll() is None:
        for name in NAMES:
            message = client.wait_for_message(name, timeout=0)
            if message is None or last.get(name) == message.metadata.get("Frame"):
                continue
            if began is None:
                began = (time.monotonic(), cpu_s(bridge.pid))
            last[name] = message.metadata.get("Frame")
            require(message.metadata.get("TransformStatus") is not None, f"{name} has no status")
            heard[name, int(last[name])] = np.array(message.matrix, dtype=np.float32)
        time.sleep(0.0005)
    require(began is not None, "nothing came")
    elapsed = time.monotonic() - began[0]
    share = (cpu_s(bridge.pid) - began[1]) / elapsed
    client.stop()
    return heard, elapsed, share


def matrix_of(pose):
    w, x, y, z = pose.rotation_wxyz
    rotation = np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])
    return np.hstack([rotation, np.array(pose.position_mm).reshape(3, 1)])


def compare(path, heard):
    """How many transforms were compared, and the largest difference, mm and of rotations 1."""
    compared, worst = 0, 0.0
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, _, _, frame in reader.iter_decoded_messages(topics=["poses"]):
            for name, body in BODIES.items():
                matrix = heard.get((name, frame.field))
                if matrix is not None:
                    expected = matrix_of(frame.bodies[body].world_from_body)
                    worst = max(worst, float(np.abs(matrix[:3] - expected).max()))
                    compared += 1
    return compared, worst


def main(vitreo, path, seconds=SECONDS):
    port = free_port()
    bridge = subprocess.Popen([vitreo, "bridge", "--igtl", str(port), "--instance", "igtl"])
    try:
        run = subprocess.Popen([
            vitreo, "run", "--no-picture", "--direct", "--rig", str(ROOT / "assets/rig-200hz.json"),
            "--instance", "igtl", "--duration", str(seconds), "--force", "--record", path,
        ], stdout=subprocess.DEVNULL)
        heard, elapsed, share = receive(port, run, bridge)
    finally:
        bridge.terminate()
    require(bridge.wait() == 0, "the bridge ended with an error")
    rates = Counter(name for name, _ in heard)
    for name in NAMES:
        print(f"{name}: {rates[name] / elapsed:.0f} Hz")
    compared, worst = compare(path, heard)
    print(f"{compared} transforms compared, largest difference {worst:.1e}")
    print(f"the bridge took {100 * share:.2f} % of a core "
          f"in {elapsed:.0f} s (load of the machine {os.getloadavg()[0]:.1f})")
    require(compared > 100, "too few transforms were compared")
    # Twelve 32-bit numbers of up to 100 mm.
    require(worst < 1e-5, "transforms are not those of the recording")
    require(share < MOST_CPU, f"the bridge took more than {100 * MOST_CPU:.0f} % of a core")


if __name__ == "__main__":
    require(len(sys.argv) in (3, 4), "expected VITREO, FILE.mcap and perhaps SECONDS")
    main(*sys.argv[1:])
