"""The blocks of vitreo as ctypes has them. Made from the sources; do not edit."""

from ctypes import Structure, c_double, c_uint8, c_uint32, c_uint64

#: Handed to the library, which refuses blocks of another version.
LAYOUT = 0x5fd3db0380ad7ae2
MAX_BLOBS = 64
MAX_CAMERAS = 8
INSTRUMENTS = 2
BODIES = 3
MAX_FIELDS_USED = 16
OSCILLATORS = 2
TEXT_BYTES = 112
COVARIANCE_ENTRIES = 21
EYE = 2
BLOB_MERGED = 1
BLOB_CLIPPED = 2
BLOB_SATURATED = 4
FORMAT_YCBCR_422 = 1
WHOLE_FRAME = 2
STATE_STARTING = 0
STATE_RUNNING = 1
STATE_DEGRADED = 2
STATE_FINISHED = 3


class Blob(Structure):
    """Blob, as in vitreo.h."""

    _fields_ = [
        ("x_px", c_double),
        ("y_field_px", c_double),
        ("area_px", c_double),
        ("width_px", c_double),
        ("height_px", c_double),
        ("var_x_px2", c_double),
        ("var_y_px2", c_double),
        ("cov_xy_px2", c_double),
        ("colour", c_uint32),
        ("flags", c_uint32),
    ]


class BlobField(Structure):
    """BlobField, as in vitreo.h."""

    _fields_ = [
        ("field", c_uint64),
        ("exposed_ns", c_uint64),
        ("read_out_ns", c_uint64),
        ("blobs_out_ns", c_uint64),
        ("camera", c_uint32),
        ("parity", c_uint32),
        ("count", c_uint32),
        ("blobs_left_out", c_uint32),
        ("blobs", Blob * 64),
    ]


class FieldHeader(Structure):
    """FieldHeader, as in vitreo.h."""

    _fields_ = [
        ("field", c_uint64),
        ("exposed_ns", c_uint64),
        ("first_line_ns", c_uint64),
        ("line_period_ns", c_uint64),
        ("camera", c_uint32),
        ("parity", c_uint32),
        ("format", c_uint32),
        ("width", c_uint32),
        ("height", c_uint32),
        ("lines", c_uint32),
    ]


class HandleState(Structure):
    """HandleState, as in vitreo.h."""

    _fields_ = [
        ("seq", c_uint64),
        ("field", c_uint64),
        ("instant_ns", c_uint64),
        ("instrument", c_uint32),
        ("tool", c_uint32),
        ("jaw_rad", c_double),
    ]


class PedalState(Structure):
    """PedalState, as in vitreo.h."""

    _fields_ = [
        ("seq", c_uint64),
        ("instant_ns", c_uint64),
        ("axes", c_double * 2),
        ("buttons", c_uint32),
        ("mode", c_uint32),
    ]


class Instants(Structure):
    """Instants, as in vitreo.h."""

    _fields_ = [
        ("exposed", c_uint64),
        ("read_out", c_uint64),
        ("blobs_out", c_uint64),
        ("taken", c_uint64),
        ("tracked", c_uint64),
        ("stepped", c_uint64),
    ]


class FieldUsed(Structure):
    """FieldUsed, as in vitreo.h."""

    _fields_ = [
        ("field", c_uint64),
        ("exposed_ns", c_uint64),
        ("camera", c_uint32),
        ("blobs_used", c_uint32),
    ]


class Pose(Structure):
    """Pose, as in vitreo.h."""

    _fields_ = [
        ("position_mm", c_double * 3),
        ("rotation_wxyz", c_double * 4),
    ]


class Oscillator(Structure):
    """Oscillator, as in vitreo.h."""

    _fields_ = [
        ("omega_rad_s", c_double),
        ("damping", c_double),
        ("position_mm", c_double * 3),
        ("velocity_mm_s", c_double * 3),
    ]


class Predictor(Structure):
    """Predictor, as in vitreo.h."""

    _fields_ = [
        ("velocity_mm_s", c_double * 3),
        ("acceleration_mm_s2", c_double * 3),
        ("acceleration_tau_s", c_double),
        ("velocity_tau_s", c_double),
        ("angular_velocity_rad_s", c_double * 3),
        ("oscillators", Oscillator * 2),
    ]


class BodyState(Structure):
    """BodyState, as in vitreo.h."""

    _fields_ = [
        ("world_from_body", Pose),
        ("covariance", c_double * 21),
        ("predictor", Predictor),
        ("residual_px", c_double),
        ("measured_ns", c_uint64),
        ("validity", c_uint32),
        ("status", c_uint32),
        ("blobs_used", c_uint32),
        ("cameras_used", c_uint32),
    ]


class TrackerFrame(Structure):
    """TrackerFrame, as in vitreo.h."""

    _fields_ = [
        ("field", c_uint64),
        ("frame", c_uint64),
        ("instants", Instants),
        ("waited_ns", c_uint64),
        ("camera", c_uint32),
        ("closed_by", c_uint32),
        ("used_count", c_uint32),
        ("fields_refused", c_uint32),
        ("used", FieldUsed * 16),
        ("bodies", BodyState * 3),
        ("cameras_left_out", c_uint32),
        ("cameras_estimated", c_uint32),
    ]


class Event(Structure):
    """Event, as in vitreo.h."""

    _fields_ = [
        ("seq", c_uint64),
        ("field", c_uint64),
        ("exposed_ns", c_uint64),
        ("kind", c_uint32),
        ("severity", c_uint32),
        ("instrument", c_uint32),
        ("subject", c_uint32),
        ("value", c_double),
        ("limit", c_double),
        ("position_in_eye_mm", c_double * 3),
    ]


class Health(Structure):
    """Health, as in vitreo.h."""

    _fields_ = [
        ("instant_ns", c_uint64),
        ("received", c_uint64),
        ("sent", c_uint64),
        ("lost", c_uint64),
        ("refused", c_uint64),
        ("cpu_ns", c_uint64),
        ("process", c_uint32),
        ("pid", c_uint32),
        ("state", c_uint32),
        ("reserved", c_uint32),
        ("text", c_uint8 * 112),
    ]
