#!/usr/bin/env python3
"""lsl_client.py BINARIES FILE.mcap: poses and events through the Lab Streaming Layer, compared with the recording.

Starts a simulator and `python -m vitreo.lsl`, reads both streams with pylsl, then compares every sample and its
stamp with the recording, bit for bit. Prints how many were compared. Exit code 1 where something is wrong.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import pylsl
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

ROOT = Path(__file__).resolve().parents[2]
SECONDS = 10


def require(holds, message):
    if not holds:
        raise SystemExit(f"lsl_client: {message}")


def inlet(kind):
    """The stream of that type of this run; its first samples are read before the run is over."""
    found = pylsl.resolve_bypred(f"type='{kind}' and source_id='vitreo-lsl-{SOURCES[kind]}'", timeout=30)
    require(len(found) == 1, f"{len(found)} streams of type {kind} were found")
    stream = pylsl.StreamInlet(found[0])
    stream.open_stream(timeout=10)
    return stream


SOURCES = {"MoCap": "poses", "Markers": "events"}


def receive(bridge):
    """All samples of both streams until they end."""
    streams, heard = {kind: inlet(kind) for kind in SOURCES}, {kind: [] for kind in SOURCES}
    labels, channel = [], streams["MoCap"].info().desc().child("channels").child("channel")
    while not channel.empty():
        labels.append(channel.child_value("label"))
        channel = channel.next_sibling()
    require(len(labels) == 27 and labels[9] == "inst1.x", f"channels are named {labels}")
    last = False
    while not last:
        last = bridge.poll() is not None
        for kind, stream in streams.items():
            sample, stamp = stream.pull_sample(timeout=0.05)
            while sample:
                heard[kind].append((stamp, sample))
                sample, stamp = stream.pull_sample(timeout=0)
    return heard["MoCap"], heard["Markers"]


def recorded(path):
    """Samples by stamp, as the recording has them."""
    poses, events = {}, set()
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, _, item in reader.iter_decoded_messages(topics=["poses", "events"]):
            if channel.topic == "events":
                events.add((item.exposed_ns * 1e-9, item.kind, item.value))
                continue
            sample = []
            for body in item.bodies:
                pose = body.world_from_body
                sample += [*pose.position_mm, *pose.rotation_wxyz, body.validity, body.residual_px]
            poses[item.instants.exposed * 1e-9] = sample
    return poses, events


def main(binaries, path):
    environment = {**os.environ, "VITREO_LIBRARY": str(Path(binaries).resolve() / "libvitreo.so")}
    paths = [str(ROOT / "drivers/python"), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment["PYTHONPATH"] = os.pathsep.join(paths)
    run = subprocess.Popen([
        f"{binaries}/vitreo", "run", "--no-picture", "--direct", "--instance", "lsl", "--duration", str(SECONDS),
        "--force", "--record", path,
    ], stdout=subprocess.DEVNULL)
    bridge = subprocess.Popen([sys.executable, "-m", "vitreo.lsl", "--instance", "lsl"], env=environment)
    try:
        heard, told = receive(bridge)
    finally:
        bridge.terminate()
    require(bridge.wait() == 0, "vitreo.lsl ended with an error")
    require(run.wait() == 0, "the run failed")
    poses, events = recorded(path)
    wrong = [stamp for stamp, sample in heard if poses.get(stamp) != sample]
    require(not wrong, f"{len(wrong)} of {len(heard)} samples are not those of the recording, the first at {wrong[:1]}")
    texts = [(stamp, json.loads(sample[0])) for stamp, sample in told]
    strange = [text for stamp, text in texts if (stamp, text["kind"], text["value"]) not in events]
    require(not strange, f"events that were not recorded: {strange[:3]}")
    print(f"{len(heard)} of {len(poses)} frames and {len(told)} of {len(events)} events compared, all identical")
    require(len(heard) > 50, "too few were compared")


if __name__ == "__main__":
    require(len(sys.argv) == 3, "expected BINARIES and FILE.mcap")
    main(*sys.argv[1:])
