"""Drivers of vitreo in Python, over libvitreo.so; see docs/drivers.md.

    with vitreo.Driver("main", "my-cameras", vitreo.SENDS_BLOBS, wait_s=30) as driver:
        driver.send(field)

The library is looked for in VITREO_LIBRARY, then where the system keeps its libraries. Needs nothing else.
"""

import ctypes
import os
from ctypes import POINTER, byref, c_char_p, c_int32, c_size_t, c_uint8, c_uint32, c_uint64, sizeof

from . import blocks
from .blocks import *  # noqa: F403

SENDS_BLOBS, SENDS_FIELDS, SENDS_HANDLES, SENDS_PEDAL, SENDS_POSES = 1, 2, 4, 8, 16
READS_POSES, READS_EVENTS, READS_HEALTH = 256, 512, 1024
COLOURS = {"red": 1, "yellow": 2, "green": 3, "cyan": 4, "blue": 5, "magenta": 6, "white": 7}
OK, NOTHING, STOP = 0, 1, 2


class Error(Exception):
    """A call that did not do what it was asked; `code` as in vitreo.h."""

    def __init__(self, code, text):
        super().__init__(text)
        self.code = code


class Stopped(Error):
    """The run has ended, or asks this program to end."""


def _load():
    name = os.environ.get("VITREO_LIBRARY", "libvitreo.so")
    try:
        library = ctypes.CDLL(name)
    except OSError as problem:
        raise ImportError(f"{problem}: set VITREO_LIBRARY to the path of libvitreo.so") from None
    number, size, wait = c_uint64, c_size_t, c_int32
    calls = {
        "open": [c_char_p, c_char_p, c_uint32, c_uint64, wait, POINTER(number)],
        "lend_field": [number, POINTER(blocks.FieldHeader), size, POINTER(POINTER(c_uint8)), POINTER(size)],
        "tell": [number, c_int32, c_char_p],
        **{name: [number] for name in ("close", "check", "send_field", "finish")},
    }
    for name, block in _SENDS.items():
        calls[name] = [number, POINTER(block), size]
    for name, block in _READS.items():
        calls[name] = [number, POINTER(block), size, wait]
    for name, arguments in calls.items():
        call = getattr(library, f"vitreo_{name}")
        call.argtypes, call.restype = arguments, c_int32
    library.vitreo_now.restype = library.vitreo_layout.restype = c_uint64
    library.vitreo_error_text.restype = c_char_p
    return library


_SENDS = {
    "send_blobs": blocks.BlobField,
    "send_handle": blocks.HandleState,
    "send_pedal": blocks.PedalState,
    "send_poses": blocks.TrackerFrame,
}
_READS = {"next_poses": blocks.TrackerFrame, "next_event": blocks.Event, "next_health": blocks.Health}
_LIBRARY = _load()


def _checked(code):
    if code in (OK, NOTHING):
        return code
    text = _LIBRARY.vitreo_error_text().decode()
    raise (Stopped if code == STOP else Error)(code, text)


def now():
    """The present instant of CLOCK_MONOTONIC, ns: the clock of every instant in every block."""
    return _LIBRARY.vitreo_now()


class Driver:
    """A driver in a run, which is left where the `with` ends. Only the thread that made it can use it."""

    def __init__(self, instance, name, roles, wait_s=0.0):
        """Joins a run, which is waited for; `roles`: a sum of SENDS_… and READS_…."""
        self._driver = c_uint64()
        wait_ms = int(wait_s * 1000)
        opened = _LIBRARY.vitreo_open(
            instance.encode(), name.encode(), roles, blocks.LAYOUT, wait_ms, byref(self._driver)
        )
        _checked(opened)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def close(self):
        """Leaves the run; a second time does nothing."""
        if self._driver.value:
            _LIBRARY.vitreo_close(self._driver)
            self._driver = c_uint64()

    def running(self):
        """True while the run goes on."""
        code = _LIBRARY.vitreo_check(self._driver)
        return code != STOP and _checked(code) == OK

    def send(self, block):
        """Sends a BlobField, HandleState, PedalState or TrackerFrame."""
        for name, kind in _SENDS.items():
            if isinstance(block, kind):
                _checked(getattr(_LIBRARY, f"vitreo_{name}")(self._driver, byref(block), sizeof(block)))
                return
        raise TypeError(f"expected BlobField, HandleState, PedalState or TrackerFrame, found {type(block).__name__}")

    def lend_field(self, header):
        """Shared memory for the pixels of a field, as a writable memoryview, valid until `send_field`."""
        memory, size = POINTER(c_uint8)(), c_size_t()
        lent = _LIBRARY.vitreo_lend_field(self._driver, byref(header), sizeof(header), byref(memory), byref(size))
        _checked(lent)
        pixels = ctypes.cast(memory, POINTER(c_uint8 * size.value)).contents
        return memoryview(pixels).cast("B")

    def send_field(self):
        """Sends the field that was lent."""
        _checked(_LIBRARY.vitreo_send_field(self._driver))

    def _next(self, name, wait_s):
        block = _READS[name]()
        wait_ms = -1 if wait_s is None else int(wait_s * 1000)
        code = getattr(_LIBRARY, f"vitreo_{name}")(self._driver, byref(block), sizeof(block), wait_ms)
        return block if _checked(code) == OK else None

    def next_poses(self, wait_s=0.0):
        """The next TrackerFrame; None where none came in time (`wait_s` None: waits for ever)."""
        return self._next("next_poses", wait_s)

    def next_event(self, wait_s=0.0):
        """The next Event; as `next_poses`."""
        return self._next("next_event", wait_s)

    def next_health(self, wait_s=0.0):
        """The next Health; as `next_poses`."""
        return self._next("next_health", wait_s)

    def tell(self, degraded, text):
        """Says that it works, or does so with a limitation, which people are shown."""
        _checked(_LIBRARY.vitreo_tell(self._driver, int(degraded), text.encode()))

    def finish(self):
        """Says that nothing more will come."""
        _checked(_LIBRARY.vitreo_finish(self._driver))
