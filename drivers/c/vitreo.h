/* Drivers of vitreo: see docs/drivers.md. Made from the sources by cbindgen; do not edit.
* Units are mm, g, s, rad; instants are ns of CLOCK_MONOTONIC. */

#ifndef VITREO_H
#define VITREO_H

#include <stddef.h>
#include <stdint.h>

/** The layout of the blocks below, for vitreo_open. */
#define VITREO_LAYOUT UINT64_C(0x5fd3db0380ad7ae2)

#define VITREO_MAX_BLOBS 64
#define VITREO_MAX_CAMERAS 8
#define VITREO_INSTRUMENTS 2
#define VITREO_BODIES 3
#define VITREO_MAX_FIELDS_USED 16
#define VITREO_OSCILLATORS 2
#define VITREO_TEXT_BYTES 112
#define VITREO_COVARIANCE_ENTRIES 21
#define VITREO_EYE 2
#define VITREO_BLOB_MERGED 1
#define VITREO_BLOB_CLIPPED 2
#define VITREO_BLOB_SATURATED 4
#define VITREO_FORMAT_YCBCR_422 1
#define VITREO_WHOLE_FRAME 2
#define VITREO_STATE_STARTING 0
#define VITREO_STATE_RUNNING 1
#define VITREO_STATE_DEGRADED 2
#define VITREO_STATE_FINISHED 3


// Sends blobs: takes the place of cameras and camera hardware.
#define VITREO_SENDS_BLOBS 1

// Sends fields of pixels: takes the place of cameras.
#define VITREO_SENDS_FIELDS 2

// Sends what the handles of the instruments do.
#define VITREO_SENDS_HANDLES 4

// Sends what the foot pedal does.
#define VITREO_SENDS_PEDAL 8

// Sends poses: takes the place of cameras and tracker.
#define VITREO_SENDS_POSES 16

// Reads poses.
#define VITREO_READS_POSES 256

// Reads events.
#define VITREO_READS_EVENTS 512

// Reads heartbeats.
#define VITREO_READS_HEALTH 1024

// How a camera gives its pixels. Names are those of V4L2 (`YUYV`) and GenICam (the others).
enum VitreoPixelFormat
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : uint32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
  // YCbCr 4:2:2, in planes.
  VITREO_PIXEL_FORMAT_YUYV = 1,
  // Brightness alone, 0 to 255: no colours.
  VITREO_PIXEL_FORMAT_Y8 = 2,
  // Red, green, blue of a pixel, then of the next, 0 to 255.
  VITREO_PIXEL_FORMAT_RGB8 = 3,
  // One sample a pixel behind a mosaic of filters; the first line begins red, green.
  VITREO_PIXEL_FORMAT_BAYER_RG8 = 4,
  // The first line begins blue, green.
  VITREO_PIXEL_FORMAT_BAYER_BG8 = 5,
  // The first line begins green, red.
  VITREO_PIXEL_FORMAT_BAYER_GR8 = 6,
  // The first line begins green, blue.
  VITREO_PIXEL_FORMAT_BAYER_GB8 = 7,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum VitreoPixelFormat VitreoPixelFormat;
#else
typedef uint32_t VitreoPixelFormat;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

// Colour class of a marker, as in the camera's look-up table.
enum VitreoColour
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : uint32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
  VITREO_COLOUR_RED = 1,
  VITREO_COLOUR_YELLOW = 2,
  VITREO_COLOUR_GREEN = 3,
  VITREO_COLOUR_CYAN = 4,
  VITREO_COLOUR_BLUE = 5,
  VITREO_COLOUR_MAGENTA = 6,
  VITREO_COLOUR_WHITE = 7,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum VitreoColour VitreoColour;
#else
typedef uint32_t VitreoColour;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

// Tool of an instrument.
enum VitreoTool
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : uint32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
  VITREO_TOOL_FORCEPS = 1,
  VITREO_TOOL_LIGHT_PIPE = 2,
  VITREO_TOOL_PICK = 3,
  VITREO_TOOL_VITRECTOR = 4,
  VITREO_TOOL_NEEDLE = 5,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum VitreoTool VitreoTool;
#else
typedef uint32_t VitreoTool;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

// Meaning of the pedal's axes.
enum VitreoPedalMode
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : uint32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
  // Both axes move the microscope.
  VITREO_PEDAL_MODE_MOVE = 0,
  // The first axis zooms, the second focuses.
  VITREO_PEDAL_MODE_ZOOM = 1,
  // The first axis is the share of the full suction, the second that of the full cut rate; below
  // 0 counts as 0.
  VITREO_PEDAL_MODE_ASPIRATE = 2,
  // The first axis is the share of the full injection pressure; below 0 counts as 0.
  VITREO_PEDAL_MODE_INJECT = 3,
  // Fluid–air exchange: the first axis is the share of the full flow of air, the second that of
  // fluid; below 0 counts as 0.
  VITREO_PEDAL_MODE_EXCHANGE = 4,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum VitreoPedalMode VitreoPedalMode;
#else
typedef uint32_t VitreoPedalMode;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

// How far a value may be trusted. Travels with the value; a zero pose is never a signal.
enum VitreoValidity
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : uint32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
  // Nothing is known; the numbers beside it are the last good ones.
  VITREO_VALIDITY_LOST = 0,
  // Extrapolated from earlier measurements.
  VITREO_VALIDITY_PREDICTED = 1,
  // A measurement of this very instant took part.
  VITREO_VALIDITY_MEASURED = 2,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum VitreoValidity VitreoValidity;
#else
typedef uint32_t VitreoValidity;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

// Tracking status of a body, in the terms of surgical trackers.
enum VitreoBodyStatus
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : uint32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
  VITREO_BODY_STATUS_TRACKED = 0,
  VITREO_BODY_STATUS_PARTLY_OUT_OF_VOLUME = 1,
  VITREO_BODY_STATUS_TOO_FEW_MARKERS = 2,
  VITREO_BODY_STATUS_BAD_FIT = 3,
  VITREO_BODY_STATUS_INTERFERENCE = 4,
  VITREO_BODY_STATUS_FELL_BEHIND = 5,
  VITREO_BODY_STATUS_PREDICTED = 6,
  VITREO_BODY_STATUS_LOST = 7,
  VITREO_BODY_STATUS_CAMERAS_DISAGREE = 8,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum VitreoBodyStatus VitreoBodyStatus;
#else
typedef uint32_t VitreoBodyStatus;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

// The processes of a simulator. The desk takes the place of virtual rig, camera hardware and
// tracker; the camera hardware runs where there are pixels to scan, controls where pedal or handles are real.
// Drivers are programs of other makers, which the launcher does not start; each is named for the channel that
// it sends on.
enum VitreoProcess
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : uint32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
  VITREO_PROCESS_FPGA_MODEL = 0,
  VITREO_PROCESS_TRACKER = 1,
  VITREO_PROCESS_SIMCORE = 2,
  VITREO_PROCESS_RENDERER = 3,
  VITREO_PROCESS_DESK = 4,
  VITREO_PROCESS_VIRTUAL_RIG = 5,
  VITREO_PROCESS_CONTROLS = 6,
  VITREO_PROCESS_BLOBS_DRIVER = 16,
  VITREO_PROCESS_FIELDS_DRIVER = 17,
  VITREO_PROCESS_HANDLES_DRIVER = 18,
  VITREO_PROCESS_PEDAL_DRIVER = 19,
  VITREO_PROCESS_POSES_DRIVER = 20,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum VitreoProcess VitreoProcess;
#else
typedef uint32_t VitreoProcess;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

// How a call ended. 0 and above: it did what it was asked; below 0: it did not.
enum VitreoCode
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : int32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
  // Done.
  VITREO_OK = 0,
  // Nothing new came within the time.
  VITREO_NOTHING = 1,
  // The run has ended or asks this program to end: close the driver.
  VITREO_STOP = 2,
  // A pointer is NULL that must not be.
  VITREO_NULL = -1,
  // No driver of this thread has this number: it was closed, or another thread opened it.
  VITREO_CLOSED = -2,
  // A size is not that of the block: the program was compiled with another header.
  VITREO_SIZE = -3,
  // A name or an option makes no sense.
  VITREO_ARGUMENT = -4,
  // The program was compiled with the header of another version than the library's.
  VITREO_HEADER = -5,
  // The running vitreo was built with other blocks than the library.
  VITREO_SCHEMA = -6,
  // No run of this name came up within the time.
  VITREO_NO_RUN = -7,
  // The run does not take this from outside: see `vitreo run --external`.
  VITREO_NOT_INVITED = -8,
  // The driver was not opened for this.
  VITREO_ROLE = -9,
  // A number of the block makes no sense.
  VITREO_INVALID = -10,
  // The transport or the system failed.
  VITREO_SYSTEM = -11,
  // A field is lent already, or none is.
  VITREO_LOAN = -12,
  // A defect of the library; please report it.
  VITREO_DEFECT = -13,
  // Another driver sends this already: two would be mixed.
  VITREO_TAKEN = -14,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum VitreoCode VitreoCode;
#else
typedef int32_t VitreoCode;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

// Nanoseconds of `CLOCK_MONOTONIC`. Zero means "not yet".
typedef uint64_t VitreoNanos;

// One bright region of one colour.
typedef struct VitreoBlob {
  // Centre, px; column in the frame.
  double x_px;
  // Centre, px; **line of the field** ([`frame_line`]).
  double y_field_px;
  // Area, px of the field.
  double area_px;
  // Width of the bounding box, px.
  double width_px;
  // Height of the bounding box, field lines.
  double height_px;
  // Variance of `x_px`, px².
  double var_x_px2;
  // Variance of the centre's line **in the frame**, px².
  double var_y_px2;
  // Covariance of the two, px².
  double cov_xy_px2;
  // [`Colour`] on the wire.
  uint32_t colour;
  // Bits `BLOB_…`.
  uint32_t flags;
} VitreoBlob;

// All blobs of one camera-field.
typedef struct VitreoBlobField {
  // Field number of this camera; stamped at the camera.
  uint64_t field;
  // Middle of the exposure.
  VitreoNanos exposed_ns;
  // Last line left the sensor.
  VitreoNanos read_out_ns;
  // When the blobs were sent; on a replayed stream, when they were received.
  VitreoNanos blobs_out_ns;
  // Camera id of the rig.
  uint32_t camera;
  // 0: even lines, 1: odd lines, 2: all lines ([`WHOLE_FRAME`]).
  uint32_t parity;
  // Blobs in use.
  uint32_t count;
  // Blobs seen beyond the capacity.
  uint32_t blobs_left_out;
  // The blobs; the first `count` are meaningful.
  struct VitreoBlob blobs[VITREO_MAX_BLOBS];
} VitreoBlobField;

// State of one handle.
typedef struct VitreoHandleState {
  // Counts up by one with every message of this sender.
  uint64_t seq;
  // Field it belongs to.
  uint64_t field;
  // When it was read.
  VitreoNanos instant_ns;
  // 0 or 1.
  uint32_t instrument;
  // [`Tool`] on the wire.
  uint32_t tool;
  // Opening between the jaws, rad.
  double jaw_rad;
} VitreoHandleState;

// State of the foot pedal.
typedef struct VitreoPedalState {
  // Counts up by one with every message of this sender.
  uint64_t seq;
  // When it was read.
  VitreoNanos instant_ns;
  // Two axes, −1 to 1.
  double axes[2];
  // Held buttons: bits of [`crate::optics::PedalButton`].
  uint32_t buttons;
  // Meaning of the axes: [`PedalMode`] on the wire.
  uint32_t mode;
} VitreoPedalState;

// The instants a field passes on its way from the sensor to the end of the simulation step, ns.
//
// Stamped once and carried unchanged by every later message; zero where not reached yet.
typedef struct VitreoInstants {
  // Middle of the exposure of the reference camera.
  VitreoNanos exposed;
  // Last line of the last used field left the sensor.
  VitreoNanos read_out;
  // The last used field's blobs were sent.
  VitreoNanos blobs_out;
  // The tracker had every blob it used for this frame (`tracked - taken` is tracking proper).
  VitreoNanos taken;
  // The tracker published the poses.
  VitreoNanos tracked;
  // The simulation finished the step.
  VitreoNanos stepped;
} VitreoInstants;

// A camera-field that went into a frame.
typedef struct VitreoFieldUsed {
  // Field number of that camera.
  uint64_t field;
  // Its mid-exposure.
  VitreoNanos exposed_ns;
  // Camera id.
  uint32_t camera;
  // Blobs of it that a body took.
  uint32_t blobs_used;
} VitreoFieldUsed;

// A rigid transform `target_from_source`: position in mm, unit quaternion (w, x, y, z).
typedef struct VitreoPose {
  // Origin of the source frame in the target frame, mm.
  double position_mm[3];
  // Rotation target-from-source as (w, x, y, z).
  double rotation_wxyz[4];
} VitreoPose;

// One damped oscillator of a tremor, per axis: x'' + 2 ζ ω x' + ω² x = 0 about the smooth motion.
typedef struct VitreoOscillator {
  // ω, rad/s; 0 means unused.
  double omega_rad_s;
  // ζ.
  double damping;
  // Displacement at the frame's instant, mm (world).
  double position_mm[3];
  // Its velocity, mm/s (world).
  double velocity_mm_s[3];
} VitreoOscillator;

// Motion state by which [`crate::predict`] carries a pose to another instant. World frame.
typedef struct VitreoPredictor {
  // Velocity of the origin (tip), without the oscillators, mm/s.
  double velocity_mm_s[3];
  // Acceleration, without the oscillators, mm/s².
  double acceleration_mm_s2[3];
  // Time constant with which the acceleration dies out, s; 0 means it is not used.
  double acceleration_tau_s;
  // Time constant with which the velocity dies out, s; 0 means that it is constant.
  double velocity_tau_s;
  // Angular velocity in the world, rad/s.
  double angular_velocity_rad_s[3];
  // Tremor.
  struct VitreoOscillator oscillators[VITREO_OSCILLATORS];
} VitreoPredictor;

// One body at the frame's instant.
typedef struct VitreoBodyState {
  // `world_from_body`: tip and axes of an instrument; the eye's rotation, position 0.
  struct VitreoPose world_from_body;
  // Upper triangle of the covariance of (position, mm; rotation vector, rad), both in the world.
  double covariance[VITREO_COVARIANCE_ENTRIES];
  // Its motion.
  struct VitreoPredictor predictor;
  // Root mean square of the image residuals of markers that are seen whole, px; 0 where there is none.
  double residual_px;
  // Instant of the last measurement that took part.
  VitreoNanos measured_ns;
  // [`Validity`] on the wire.
  uint32_t validity;
  // [`BodyStatus`] on the wire.
  uint32_t status;
  // Blobs that took part.
  uint32_t blobs_used;
  // Cameras that took part.
  uint32_t cameras_used;
} VitreoBodyState;

// The tracker's result for one exposure of the reference camera.
typedef struct VitreoTrackerFrame {
  // Field number of the reference camera.
  uint64_t field;
  // Counts up by one from 0 since the tracker started; 0 therefore marks a fresh tracker.
  uint64_t frame;
  // Instants so far; `stepped` is 0.
  struct VitreoInstants instants;
  // Time spent waiting for a late camera after the first field arrived, ns.
  uint64_t waited_ns;
  // Reference camera.
  uint32_t camera;
  // [`ClosedBy`] on the wire.
  uint32_t closed_by;
  // Camera-fields consumed by this frame, in this order.
  uint32_t used_count;
  // Fields refused since the start: unknown camera, invalid, twice or out of order.
  uint32_t fields_refused;
  // The consumed camera-fields; the first `used_count` are meaningful.
  struct VitreoFieldUsed used[VITREO_MAX_FIELDS_USED];
  // Instruments 0 and 1, then the eye.
  struct VitreoBodyState bodies[VITREO_BODIES];
  // Set of the cameras (a bit each, by id) that were moved, so that their blobs are not used.
  uint32_t cameras_left_out;
  // Set of the cameras that are used where they were estimated to stand, not where the rig file has
  // them.
  uint32_t cameras_estimated;
} VitreoTrackerFrame;

// What a field is and when it was taken.
typedef struct VitreoFieldHeader {
  // Field number of this camera; stamped at the camera.
  uint64_t field;
  // Middle of the exposure.
  VitreoNanos exposed_ns;
  // The first pixel of the first line leaves the sensor. A block may come before that instant.
  VitreoNanos first_line_ns;
  // From one line to the next, ns.
  uint64_t line_period_ns;
  // Camera id of the rig.
  uint32_t camera;
  // 0: even lines, 1: odd lines, 2: all lines ([`WHOLE_FRAME`]).
  uint32_t parity;
  // [`PixelFormat`] on the wire.
  uint32_t format;
  // Pixels a line; even.
  uint32_t width;
  // Lines of the field.
  uint32_t height;
  // Lines in the payload, from the top; at most `height`.
  uint32_t lines;
} VitreoFieldHeader;

// One thing that happened.
typedef struct VitreoEvent {
  // Counts up by one since the simulation began.
  uint64_t seq;
  // Field of the step.
  uint64_t field;
  // Exposure instant of the step.
  VitreoNanos exposed_ns;
  // [`EventKind`] on the wire.
  uint32_t kind;
  // [`Severity`] on the wire.
  uint32_t severity;
  // Instrument or [`NO_INSTRUMENT`].
  uint32_t instrument;
  // Node, triangle or body concerned; 0 if none.
  uint32_t subject;
  // Figure of the event, in the unit of its kind.
  double value;
  // Limit that was passed, in the same unit; 0 if none.
  double limit;
  // Where, in the eye frame, mm.
  double position_in_eye_mm[3];
} VitreoEvent;

// A heartbeat.
typedef struct VitreoHealth {
  // Sender's instant.
  VitreoNanos instant_ns;
  // Blocks it has taken in.
  uint64_t received;
  // Blocks it has sent.
  uint64_t sent;
  // Blocks it lost in its queues.
  uint64_t lost;
  // Blocks it refused.
  uint64_t refused;
  // CPU time it has used, ns.
  uint64_t cpu_ns;
  // [`Process`] on the wire.
  uint32_t process;
  // Its operating-system id.
  uint32_t pid;
  // One of `STATE_…`.
  uint32_t state;
  // 0; keeps the text aligned.
  uint32_t reserved;
  // Zero-padded text: tier, degraded state and the like.
  uint8_t text[VITREO_TEXT_BYTES];
} VitreoHealth;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

// Joins the run `instance` (vitreo run --instance; "main" by default) as the driver `name`, which sends and reads what
// `roles` say (a sum of VITREO_SENDS_… and VITREO_READS_…). Where no such run is at work, waits for it for at most
// `wait_ms` (below 0: for ever). A channel has one driver: VITREO_TAKEN where another one sends it. `layout` is
// VITREO_LAYOUT. The number of the driver is written to `driver`; only this thread can use it.
//
// # Safety
// `instance` and `name` are NULL or texts that end with a zero; `driver` is NULL or can be written.
int32_t vitreo_open(const char *instance,
                    const char *name,
                    uint32_t roles,
                    uint64_t layout,
                    int32_t wait_ms,
                    uint64_t *driver);

// Leaves the run. The handle and lent memory are invalid from then on.
int32_t vitreo_close(uint64_t driver);

// VITREO_OK while the run goes on; VITREO_STOP once it has ended or asks this program to end.
int32_t vitreo_check(uint64_t driver);

// Sends the blobs of a camera-field; `blobs_out_ns` 0 becomes the present instant.
//
// # Safety
// `field` is NULL or points to `size` readable bytes.
int32_t vitreo_send_blobs(uint64_t driver, const struct VitreoBlobField *field, size_t size);

// Sends the state of a handle; the library counts `seq`, and `instant_ns` 0 becomes the present instant.
//
// # Safety
// `handle` is NULL or points to `size` readable bytes.
int32_t vitreo_send_handle(uint64_t driver, const struct VitreoHandleState *handle, size_t size);

// Sends the state of the foot pedal; the library counts `seq`, and `instant_ns` 0 becomes the present instant.
//
// # Safety
// `pedal` is NULL or points to `size` readable bytes.
int32_t vitreo_send_pedal(uint64_t driver,
                          const struct VitreoPedalState *pedal,
                          size_t size);

// Sends poses; the library counts `frame`, and `instants.tracked` 0 becomes the present instant.
//
// # Safety
// `frame` is NULL or points to `size` readable bytes.
int32_t vitreo_send_poses(uint64_t driver, const struct VitreoTrackerFrame *frame, size_t size);

// Lends shared memory for the pixels of a field: `*bytes` of them from `*memory` on, to be written until
// vitreo_send_field or vitreo_close. No field may have more than the first one's width × height asks for.
//
// # Safety
// `header` is NULL or points to `size` readable bytes; `memory` and `bytes` are NULL or can be written.
int32_t vitreo_lend_field(uint64_t driver,
                          const struct VitreoFieldHeader *header,
                          size_t size,
                          uint8_t **memory,
                          size_t *bytes);

// Sends the field that was lent.
int32_t vitreo_send_field(uint64_t driver);

// Reads the next poses; VITREO_NOTHING where none came within `wait_ms` (0: looks only; below 0: for ever).
//
// # Safety
// `frame` is NULL or points to `size` writable bytes.
int32_t vitreo_next_poses(uint64_t driver, struct VitreoTrackerFrame *frame, size_t size, int32_t wait_ms);

// Reads the next event, as vitreo_next_poses does poses.
//
// # Safety
// `event` is NULL or points to `size` writable bytes.
int32_t vitreo_next_event(uint64_t driver, struct VitreoEvent *event, size_t size, int32_t wait_ms);

// Reads the next heartbeat of any process of the run, as vitreo_next_poses does poses.
//
// # Safety
// `health` is NULL or points to `size` writable bytes.
int32_t vitreo_next_health(uint64_t driver, struct VitreoHealth *health, size_t size, int32_t wait_ms);

// Says that the driver works, or with `degraded` not 0 that it does so with a limitation, which `text` names for
// people: it stands in status and report.
//
// # Safety
// `text` is NULL or a text that ends with a zero.
int32_t vitreo_tell(uint64_t driver,
                    int32_t degraded,
                    const char *text);

// Says that nothing more will come: a run that takes its blobs, fields or poses from this driver ends in order.
int32_t vitreo_finish(uint64_t driver);

// The present instant of CLOCK_MONOTONIC, ns: the clock of every instant in every block.
uint64_t vitreo_now(void);

// Why the newest call of this thread that failed did so, in words; empty before the first. The text stays where it is
// until the next failure of this thread.
const char *vitreo_error_text(void);

// The layout of this library's blocks, to be compared with VITREO_LAYOUT.
uint64_t vitreo_layout(void);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* VITREO_H */
