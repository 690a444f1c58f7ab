#!/usr/bin/env python3
"""igtl_server.py VITREO FILE.mcap: a run takes its poses from pyigtl as another tracker, compared with the recording.

Sends both instruments and the eye 20 times a second with a timestamp of its own for each, as pyigtl does, then compares
every recorded pose with what was sent, in 32-bit floats. Prints how many were measured. Exit code 1 where something is
wrong.
"""

import socket
import subprocess
import sys
import time

import numpy as np
import pyigtl
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

SECONDS = 4
# pyigtl sends a hundred messages a second, and waits for ever where more are to be sent to nobody.
RATE_HZ = 20
NAMES = ["Instrument0ToWorld", "Instrument1ToWorld", "EyeToWorld"]
# Frames in which all three are measured; a machine that is busy elsewhere may part some.
LEAST_WHOLE = 0.9


def require(holds, message):
    if not holds:
        raise SystemExit(f"igtl_server: {message}")


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def send(server, frames):
    """Sends frames of which no two are alike; returns the places of both tips in each."""
    sent = set()
    for frame in range(frames):
        tips = (2 + 0.01 * frame, -2 - 0.01 * frame)
        for name, x in zip(NAMES, (*tips, 0.0)):
            matrix = np.eye(4)
            matrix[0, 3] = x
            server.send_message(pyigtl.TransformMessage(matrix, device_name=name, timestamp=time.time()))
        sent.add(tuple(np.float32(tips)))
        time.sleep(1 / RATE_HZ)
    return sent


def main(vitreo, path):
    port = free_port()
    server = pyigtl.OpenIGTLinkServer(port=port, local_server=True)
    run = subprocess.Popen([
        vitreo, "run", "--no-picture", "--poses", f"igtl:127.0.0.1:{port}", "--instance", "igtl-server",
        "--duration", str(SECONDS + 4), "--force", "--record", path,
    ], stdout=subprocess.DEVNULL)
    try:
        deadline = time.monotonic() + 20
        while not server.is_connected():
            require(time.monotonic() < deadline, "the run does not connect")
            time.sleep(0.02)
        sent = send(server, RATE_HZ * SECONDS)
        # pyigtl's threads end with this program; its stop() may wait for ever.
        require(run.wait() in (0, 3), "the run failed")
    finally:
        run.kill()
    whole = parts = 0
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, _, _, frame in reader.iter_decoded_messages(topics=["poses"]):
            if not all(body.validity == 2 for body in frame.bodies):
                parts += 1
                continue
            tips = tuple(np.float32(body.world_from_body.position_mm[0]) for body in frame.bodies[:2])
            require(tips in sent, f"nobody sent {tips}")
            whole += 1
    print(f"{len(sent)} frames sent, {whole} recorded with all bodies as they were sent, {parts} in parts")
    require(whole > LEAST_WHOLE * len(sent), "too few frames have all bodies")


if __name__ == "__main__":
    require(len(sys.argv) == 3, "expected VITREO and FILE.mcap")
    main(*sys.argv[1:])
