"""A tracker of another maker, made up: both instruments circle in the eye for some seconds. poses.py INSTANCE SECONDS

The run: vitreo run --external poses,handles,pedal --rig RIG.json --instance INSTANCE
"""

import math
import sys
import time

import vitreo

PERIOD_NS = 20_000_000
MEASURED = 2


def body(position_mm, at_ns, variance=1e-4):
    """A body upright at a place of the world, with its covariance: σ of 10 µm and 10 mrad, and no motion."""
    state = vitreo.BodyState(measured_ns=at_ns, validity=MEASURED)
    state.world_from_body.position_mm[:] = position_mm
    state.world_from_body.rotation_wxyz[:] = (1, 0, 0, 0)
    for row in range(6):  # the diagonal of an upper triangle, row by row
        state.covariance[row * 6 - row * (row - 1) // 2] = variance
    return state


def frame_at(number, at_ns):
    """What the tracker knows at an instant: tips in the world, mm, and the eye's rotation."""
    angle = 2 * math.pi * 0.2 * at_ns * 1e-9
    frame = vitreo.TrackerFrame(field=number)
    frame.instants.exposed = frame.instants.read_out = frame.instants.blobs_out = frame.instants.taken = at_ns
    for instrument, side in enumerate((-2.0, 2.0)):
        tip = (side + math.cos(angle), math.sin(angle), -5.0)
        frame.bodies[instrument] = body(tip, at_ns)
    frame.bodies[vitreo.EYE] = body((0, 0, 0), at_ns)
    return frame


def main(instance, seconds):
    roles = vitreo.SENDS_POSES | vitreo.SENDS_HANDLES | vitreo.SENDS_PEDAL
    with vitreo.Driver(instance, "poses-example", roles, wait_s=30) as driver:
        begun = vitreo.now()
        while driver.running():
            at = vitreo.now()
            if at > begun + float(seconds) * 1e9:
                driver.finish()
            for instrument in range(vitreo.INSTRUMENTS):
                handle = vitreo.HandleState(field=at // PERIOD_NS, instrument=instrument, tool=1 + instrument)
                driver.send(handle)
            driver.send(vitreo.PedalState())
            driver.send(frame_at(at // PERIOD_NS, at))
            time.sleep(max(0, at + PERIOD_NS - vitreo.now()) * 1e-9)


try:
    main(*sys.argv[1:])
except vitreo.Stopped:
    pass  # the run has ended
