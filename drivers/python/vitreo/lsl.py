"""Hands poses and events of a running simulator on to the Lab Streaming Layer, beside EEG, gaze or video:

    pip install './drivers/python[lsl]'
    python -m vitreo.lsl --instance main

Two streams: "vitreo poses" has 27 channels a tracker frame, nine for each instrument and the eye; "vitreo events" has
a text for each event of the simulation. Every sample has the instant of its exposure: LSL's clock on Linux is
CLOCK_MONOTONIC, which is vitreo's. Reads like a recorder and delays no other process. Ends with the run, or by Ctrl-C.
"""

import argparse
import json
import sys

import vitreo

BODIES = ("inst0", "inst1", "eye")
# Position, rotation world-from-body, how the pose is known (0 lost, 1 predicted, 2 measured), residual.
PARTS = (
    ("x", "mm"),
    ("y", "mm"),
    ("z", "mm"),
    ("qw", ""),
    ("qx", ""),
    ("qy", ""),
    ("qz", ""),
    ("validity", ""),
    ("residual", "px"),
)


def pose_stream(pylsl, instance):
    """Cameras may pass over a field, so the rate is called irregular: instants are to be taken from the stamps."""
    channels = len(BODIES) * len(PARTS)
    source = f"vitreo-{instance}-poses"
    info = pylsl.StreamInfo("vitreo poses", "MoCap", channels, pylsl.IRREGULAR_RATE, pylsl.cf_double64, source)
    described = info.desc().append_child("channels")
    for body in BODIES:
        for part, unit in PARTS:
            channel = described.append_child("channel")
            channel.append_child_value("label", f"{body}.{part}")
            channel.append_child_value("unit", unit)
    return pylsl.StreamOutlet(info)


def event_stream(pylsl, instance):
    source = f"vitreo-{instance}-events"
    info = pylsl.StreamInfo("vitreo events", "Markers", 1, pylsl.IRREGULAR_RATE, pylsl.cf_string, source)
    return pylsl.StreamOutlet(info)


def pose_sample(frame):
    """The channels of a frame, in the order of the stream's description."""
    sample = []
    for body in frame.bodies:
        pose = body.world_from_body
        sample += [*pose.position_mm, *pose.rotation_wxyz, body.validity, body.residual_px]
    return sample


def event_text(event):
    """As JSON; numbers as in docs/recording.md and vitreo.h."""
    whole = {name: getattr(event, name) for name in ("field", "kind", "severity", "instrument")}
    return json.dumps({**whole, "value": event.value, "limit": event.limit})


def serve(pylsl, driver, instance):
    """Hands on what comes, until the run ends; returns frames and events."""
    poses, events = pose_stream(pylsl, instance), event_stream(pylsl, instance)
    print(f"vitreo.lsl: streams 'vitreo poses' and 'vitreo events' of simulator '{instance}'", file=sys.stderr)
    counts = [0, 0]
    try:
        while driver.running():
            frame = driver.next_poses(0.1)
            while frame:
                poses.push_sample(pose_sample(frame), frame.instants.exposed * 1e-9)
                counts[0] += 1
                frame = driver.next_poses()
            while event := driver.next_event():
                events.push_sample([event_text(event)], event.exposed_ns * 1e-9)
                counts[1] += 1
    except (KeyboardInterrupt, vitreo.Stopped):
        pass
    return counts


def main():
    parser = argparse.ArgumentParser(
        prog="python -m vitreo.lsl", description="Hands poses and events on to the Lab Streaming Layer."
    )
    parser.add_argument("--instance", default="main", help="name of the simulator (vitreo run --instance); %(default)s")
    parser.add_argument("--wait", type=float, default=30.0, metavar="S", help="longest wait for it, s; %(default)s")
    arguments = parser.parse_args()
    try:
        import pylsl
    except (ImportError, RuntimeError) as problem:
        raise SystemExit(f"vitreo.lsl: {problem}: pip install pylsl") from None
    roles = vitreo.READS_POSES | vitreo.READS_EVENTS
    try:
        with vitreo.Driver(arguments.instance, "lsl", roles, wait_s=arguments.wait) as driver:
            frames, events = serve(pylsl, driver, arguments.instance)
    except vitreo.Stopped:
        frames, events = 0, 0
    except vitreo.Error as problem:
        raise SystemExit(f"vitreo.lsl: {problem}") from None
    print(f"vitreo.lsl: {frames} frames and {events} events handed on", file=sys.stderr)


if __name__ == "__main__":
    main()
