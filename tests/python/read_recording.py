#!/usr/bin/env python3
"""read_recording.py FILE.mcap: reads a recording with Python's mcap and nothing of vitreo.

Decodes every message of every topic from the schemas in the file, prints how many there are, and
checks what a reader relies on. Exit code 1 where something is wrong.
"""

import math
import sys
from collections import Counter

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

OWN = {
    "blobs": "vitreo.BlobField",
    "handles": "vitreo.HandleState",
    "pedal": "vitreo.PedalState",
    "poses": "vitreo.TrackerFrame",
    "steps": "vitreo.StepRecord",
    "events": "vitreo.Event",
    "frames": "vitreo.FrameRecord",
    "checkpoints": "vitreo.Checkpoint",
    "pictures": "vitreo.Picture",
    "notes": "vitreo.Note",
    "tracker-checkpoints": "vitreo.TrackerCheckpoint",
    "matches": "vitreo.Matches",
    "/tf": "foxglove.FrameTransforms",
    "/log": "foxglove.Log",
    "/picture": "foxglove.CompressedImage",
    **{f"/camera{camera}/matches": "foxglove.ImageAnnotations" for camera in range(8)},
    **{f"/camera{camera}/calibration": "foxglove.CameraCalibration" for camera in range(8)},
    "/rig": "foxglove.SceneUpdate",
}


def require(holds, message):
    if not holds:
        raise SystemExit(f"read_recording: {message}")


def check_blobs(field):
    require(field.exposed_ns > 0, f"field {field.field} has no exposure")
    for blob in field.blobs:
        require(math.isfinite(blob.x_px) and 1 <= blob.colour <= 7, f"field {field.field}: {blob}")


def check_poses(frame):
    require(len(frame.bodies) == 3, f"frame {frame.frame} has {len(frame.bodies)} bodies")
    for body in frame.bodies:
        w, x, y, z = body.world_from_body.rotation_wxyz
        require(abs(w * w + x * x + y * y + z * z - 1) < 1e-6, f"frame {frame.frame}: {body}")


def check_matches(frame):
    for field in frame.fields:
        indices = [blob.blob for blob in field.blobs]
        require(indices == list(range(len(indices))), f"frame {frame.frame}: blobs {indices}")
        for blob in field.blobs:
            numbers = (blob.x_px, blob.y_px, blob.residual_x_px, blob.residual_y_px, blob.nis)
            require(all(map(math.isfinite, numbers)), f"frame {frame.frame}: {blob}")
            require(blob.outcome <= 12 and blob.body <= 3, f"frame {frame.frame}: {blob}")


def check_transforms(message):
    for transform in message.transforms:
        require(transform.parent_frame_id == "world", f"parent {transform.parent_frame_id}")
        known = ("inst0", "inst1", "eye", *(f"camera{camera}" for camera in range(8)))
        require(transform.child_frame_id in known, transform.child_frame_id)


CHECKS = {"blobs": check_blobs, "poses": check_poses, "matches": check_matches, "/tf": check_transforms}


def metadata_of(reader):
    records = {record.name: record.metadata for record in reader.iter_metadata()}
    require("vitreo" in records, "no metadata record 'vitreo'")
    pairs = records["vitreo"]
    require(pairs.get("format") == "vitreo-recording-1", f"format {pairs.get('format')}")
    for key in ("rig_json", "scene_name", "scene_toml", "source"):
        require(pairs.get(key), f"the metadata lacks {key}")
    return pairs


def main(path):
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()], validate_crcs=True)
        require(reader.get_header().profile == "vitreo", "the profile is not vitreo")
        pairs = metadata_of(reader)
        counts, steps = Counter(), []
        offset = int(pairs.get("config.realtime-offset-ns", 0))
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            require(OWN.get(channel.topic) == schema.name, f"topic {channel.topic} is {schema.name}")
            if channel.topic == "blobs":
                # Log times are wall-clock time, instants in messages are not.
                late = message.log_time - offset - decoded.exposed_ns
                require(0 <= late < 60_000_000_000, f"field {decoded.field} is filed {late} ns late")
            CHECKS.get(channel.topic, lambda _: None)(decoded)
            counts[channel.topic] += 1
            if channel.topic == "steps":
                steps.append(decoded.step)
        summary = reader.get_summary()
        require(summary is not None, "no summary")
        require(counts.total() == summary.statistics.message_count, "messages are missing")
    require(counts["blobs"] > 0, "no blobs")
    if pairs["source"] == "live":
        for topic in ("handles", "poses", "/tf", "steps"):
            require(counts[topic] > 0, f"nothing on topic {topic}")
        require(steps == sorted(steps), "steps out of order")
    for topic, count in sorted(counts.items()):
        print(f"{topic:<12} {count:>8}")


if __name__ == "__main__":
    require(len(sys.argv) == 2, "usage: read_recording.py FILE.mcap")
    main(sys.argv[1])
