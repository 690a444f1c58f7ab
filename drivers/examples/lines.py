"""Turns a stream of blobs (docs/blob-stream.md) into lines that scanf reads: lines.py blobs.jsonl > blobs.txt

A camera-field is a line `cam seq t_ns t_rx_ns parity count`, followed by count lines `x y area w h colour`.
"""

import json
import sys

COLOURS = ["red", "yellow", "green", "cyan", "blue", "magenta", "white"]

for line in open(sys.argv[1], encoding="utf-8"):
    field = json.loads(line)
    blobs = field["blobs"]
    print(field["cam"], field["seq"], field["t_ns"], field["t_rx_ns"], field["parity"], len(blobs))
    for blob in blobs:
        numbers = [blob[key] for key in ("x", "y", "area", "w", "h")]
        print(*numbers, 1 + COLOURS.index(blob["colour"]))
