"""Plays recorded blobs into a run, as a camera system would send them: blobs.py INSTANCE blobs.jsonl

The run: vitreo run --external blobs,handles,pedal --rig RIG.json --instance INSTANCE
"""

import json
import sys
import time

import vitreo

PERIOD_NS = 20_000_000


def field_of(line, start, first):
    """A line of the stream (docs/blob-stream.md) with the instants of now."""
    field = vitreo.BlobField(
        field=start // PERIOD_NS + line["seq"],  # rising where this program is started again
        exposed_ns=start + line["t_ns"] - first,
        read_out_ns=start + line["t_rx_ns"] - first,
        camera=line["cam"],
        parity=line["parity"],
    )
    for blob in line["blobs"][: vitreo.MAX_BLOBS]:
        to = field.blobs[field.count]
        to.x_px, to.y_field_px, to.area_px = blob["x"], blob["y"], blob["area"]
        to.width_px, to.height_px, to.colour = blob["w"], blob["h"], vitreo.COLOURS[blob["colour"]]
        to.var_x_px2 = blob.get("var_x", 0.0025)
        to.var_y_px2 = blob.get("var_y", to.var_x_px2)
        field.count += 1
    return field


def main(instance, file):
    roles = vitreo.SENDS_BLOBS | vitreo.SENDS_HANDLES | vitreo.SENDS_PEDAL
    lines = [json.loads(line) for line in open(file, encoding="utf-8")]
    with vitreo.Driver(instance, "python-example", roles, wait_s=30) as driver:
        start, first = vitreo.now(), lines[0]["t_rx_ns"]
        for line in lines:
            field = field_of(line, start, first)
            time.sleep(max(0, field.read_out_ns - vitreo.now()) * 1e-9)
            driver.send(field)
            if field.camera == 0:
                for instrument, (tool, jaw) in enumerate([(1, 0.4), (2, 0.0)]):
                    handle = vitreo.HandleState(field=field.field, instrument=instrument, tool=tool, jaw_rad=jaw)
                    driver.send(handle)
                driver.send(vitreo.PedalState())
        driver.finish()
        while driver.running():  # the run ends in order
            time.sleep(0.02)


try:
    main(*sys.argv[1:])
except vitreo.Stopped:
    pass  # asked to end before the end of the file
