//! Every tuning constant of the tracker: value, unit, and what breaks when it is moved.

use protocol::limits::FIELD_PERIOD_NS;

/// Standard deviation of a blob's column where the stream tells none, px, for an area of 1 px: the
/// centre is a mean over the area, so that it falls with its root (measured: 0.046 px at 175 px, 0.033 px at 350 px).
pub const SIGMA_X_PX: f64 = 0.61;
/// The same for its line in the frame, px: a line of a field is two lines of the frame.
pub const SIGMA_Y_PX: f64 = 1.2;
/// Areas between which that rule holds, px of the field.
pub const SIGMA_AREA_PX: (f64, f64) = (20.0, 600.0);
/// Smallest and largest variance believed of a stream, px².
pub const VARIANCE_RANGE_PX2: (f64, f64) = (1e-6, 1e4);
/// Share of the area, as a logarithm, by which a marker's blob differs without being hidden in part.
pub const AREA_TOLERANCE: f64 = 0.04;
/// Shift of the centre of a partly hidden marker, in radii per logarithm of the area lost.
pub const AREA_SHIFT: f64 = 0.8;
/// Ratio of areas outside of which a blob is not that marker.
pub const AREA_RATIO: (f64, f64) = (0.15, 1.7);
/// Ratio of areas, wider, as long as the camera's own scale of areas is not known (start-up).
pub const ACQUISITION_AREA_RATIO: (f64, f64) = (0.3, 2.2);
/// Step of the running estimate of a camera's area scale.
pub const AREA_SCALE_STEP: f64 = 0.004;

/// Standard deviation of the acceleration of a hand's planned movement at the start, mm/s².
pub const VOLUNTARY_MM_S2: f64 = 15.0;
/// Time constant of its lag, s: shorter overshoots, longer lags behind a hand that turns round.
pub const VOLUNTARY_TAU_S: f64 = 0.2;
/// Bounds of its variance as learnt, mm²/s⁴: a resting hand, a hand that pulls out.
pub const VOLUNTARY_RANGE_MM2_S4: (f64, f64) = (25.0, 1e5);
/// Time over which it is learnt, s.
pub const VOLUNTARY_LEARNING_S: f64 = 1.0;
/// Squared normalised surprise (6 degrees of freedom) above which the planned movement is believed less at once.
pub const NIS_LIMIT: f64 = 30.0;
/// So many markers with a blob beside them, and more than with a blob in place, startle.
pub const MIN_NEAR_MISSES: usize = 2;
/// Doubt that a startled filter adds to the tip's position (mm), velocity (mm/s) and acceleration (mm/s²).
pub const INFLATION: [f64; 3] = [0.1, 15.0, 300.0];
/// Running ratio of surprises to what they should be, above which the same is done.
pub const NIS_RATIO_LIMIT: f64 = 1.7;
/// Share of the newest surprise in it.
pub const NIS_RATIO_GAIN: f64 = 0.15;
/// Frequencies of the tremor's oscillators, Hz: physiological tremor lies between 6 and 14 Hz.
pub const TREMOR_HZ: [f64; 5] = [7.0, 8.5, 10.0, 11.5, 13.0];
/// Their damping ratio: wide enough to overlap, narrow enough to foresee a period.
pub const TREMOR_DAMPING: f64 = 0.02;
/// The same for the roll, whose tremor is nearer to its noise: fewer and wider.
pub const ROLL_TREMOR_HZ: [f64; 3] = [8.0, 10.0, 12.0];
/// Their damping ratio.
pub const ROLL_TREMOR_DAMPING: f64 = 0.05;
/// Standard deviation of their angle at the start, rad, and bounds of its variance as learnt, rad².
pub const ROLL_TREMOR_START_RAD: f64 = 0.003;
/// See [`ROLL_TREMOR_START_RAD`].
pub const ROLL_TREMOR_RANGE_RAD2: (f64, f64) = (1e-8, 0.01);
/// Standard deviation of their displacement at the start, mm, per axis.
pub const TREMOR_START_MM: f64 = 0.018;
/// Bounds of its variance as learnt, mm².
pub const TREMOR_RANGE_MM2: (f64, f64) = (1e-7, 0.04);
/// Time over which it is learnt, s.
pub const TREMOR_LEARNING_S: f64 = 0.4;
/// Rate of the play of a shaft in its trocar, rad/s: it comes from slow movements of the hand.
pub const PLAY_RAD_S: f64 = 3.0;
/// Its damping ratio.
pub const PLAY_DAMPING: f64 = 0.7;
/// Play where the trocar is not known, mm.
pub const FREE_PLAY_MM: f64 = 1.0;
/// Distance of the pivot from the tip where the trocar is not known, mm.
pub const FREE_PIVOT_MM: f64 = 12.0;
/// Shortest distance between tip and pivot that still gives a direction, mm.
pub const SHORTEST_LEVER_MM: f64 = 4.0;
/// Longest step of the filter's prediction, ns.
pub const LONGEST_STEP_NS: u64 = FIELD_PERIOD_NS + FIELD_PERIOD_NS / 2;
/// A marker nearer to the shaft than this does not tell the roll, mm.
pub const ROLL_LEVER_MM: f64 = 0.3;
/// A blob whose place is less certain than this, by its size, tells no roll, px.
pub const ROLL_LOCALISED_PX: f64 = 1.0;
/// Blobs that tell one roll agree within this, rad: noise, a rig that has drifted by a third of a pixel, and 1 ms between
/// cameras in a turn of 10 rad/s.
pub const ROLL_AGREES_RAD: f64 = 0.06;
/// How far a blob may lie beside the ring of its marker at first sight, as a share of its radius: the ring is not quite an
/// ellipse.
pub const ROLL_RING: f64 = 0.3;
/// A ring flatter than this is seen from the side: it cannot tell front from back.
pub const ROLL_FLAT: f64 = 0.15;
/// Acceleration of a roll that went another way than foreseen, rad/s²: fingers that turn a handle by 45° in a quarter of a
/// second reach 75 (minimum jerk).
pub const ROLL_MANOEUVRE_RAD_S2: f64 = 150.0;
/// For so long it may have gone that way at the least and at the most, s.
pub const ROLL_MANOEUVRE_S: (f64, f64) = (0.02, 0.04);
/// A roll that no blob has told for longer than this comes to rest, ns, …
pub const ROLL_COAST_NS: u64 = LOST_AFTER_NS;
/// … with this time constant, s: hands do not turn on and on.
pub const ROLL_DAMPING_S: f64 = 0.2;
/// Singer model of an instrument's roll, rad/s².
pub const TURN_ACCELERATION_RAD_S2: f64 = 8.0;
/// Its time constant, s.
pub const TURN_ACCELERATION_TAU_S: f64 = 0.1;
/// The same for the eye's rotation, rad/s².
pub const EYE_ACCELERATION_RAD_S2: f64 = 0.15;
/// Its time constant, s.
pub const EYE_ACCELERATION_TAU_S: f64 = 0.7;
/// Largest factor by which it grows at a surprise, and the time in which that is forgotten, s.
pub const EYE_BOOST: (f64, f64) = (30.0, 0.3);
/// Standard deviation of the velocity of a body just found, mm/s; the surgeon's hand in a hurry.
pub const START_SPEED_MM_S: f64 = 30.0;
/// The same for the angular velocity of an instrument, rad/s.
pub const START_TURN_RAD_S: f64 = 1.5;
/// The same for the eye, rad/s.
pub const START_EYE_TURN_RAD_S: f64 = 0.5;
/// The eye's centre is the origin: standard deviation of its position, mm.
pub const EYE_CENTRE_MM: f64 = 1e-4;

/// Camera-fields this close belong to one update, ns; genlocked cameras differ by 0.1 ms.
pub const GROUP_NS: u64 = 1_000_000;
/// A sight older than this is not used for finding a lost body, ns.
pub const ACQUISITION_WINDOW_NS: u64 = FIELD_PERIOD_NS + FIELD_PERIOD_NS / 4;
/// A camera counts as seeing a body for this long after its last blob of it, ns.
pub const SEEN_NS: u64 = FIELD_PERIOD_NS + FIELD_PERIOD_NS / 2;
/// One camera alone still measures for this long after two saw the body, ns: the shaft's pivot then
/// tells the depth; later its play is no longer known well enough.
pub const ONE_CAMERA_NS: u64 = 2 * FIELD_PERIOD_NS + FIELD_PERIOD_NS / 4;
/// A body not seen by two cameras for this long is lost, ns.
pub const LOST_AFTER_NS: u64 = 150_000_000;
/// A body not seen by two cameras for this long is also searched anew, ns.
pub const ACQUIRE_AFTER_NS: u64 = 30_000_000;
/// A gap between camera-fields, or a step back, beyond which nothing is carried over, ns.
pub const MAX_GAP_NS: u64 = 500_000_000;

/// Squared Mahalanobis distance within which a blob may be a predicted marker.
pub const GATE: f64 = 25.0;
/// Farthest a blob may lie from a predicted marker, px.
pub const GATE_PX: f64 = 40.0;
/// Squared normalised residual above which a blob is thrown out of a fit.
pub const OUTLIER: f64 = 20.0;
/// A blob of a marker's colour this near to it, that is not it, disturbs, px.
pub const NEAR_PX: f64 = 5.0;
/// One blob that disturbs for so many kept is called interference.
pub const INTERFERENCE_SHARE: u32 = 4;
/// Squared residual at which the weight of a blob has fallen to half while the fit converges.
pub const ROBUST_SCALE: f64 = 9.0;
/// Reduced χ² above which a fit is refused.
pub const BAD_FIT: f64 = 9.0;
/// Bounds of a body's running reduced χ² (drifted calibration raises it).
pub const CHI2_RANGE: (f64, f64) = (1.0, 30.0);
/// Step of that running estimate.
pub const CHI2_STEP: f64 = 0.05;
/// A tip less certain than this (standard deviation, mm) is not called measured.
pub const MEASURED_MM: f64 = 0.15;
/// The same for a rotation, rad.
pub const MEASURED_RAD: f64 = 0.5;
/// A shaft that misses its trocar by more than this is not this instrument, mm.
pub const TROCAR_MISS_MM: f64 = 1.0;

/// Factor on the variances of blobs in a search: the rig may have drifted by a third of a pixel.
pub const ACQUISITION_VARIANCE: f64 = 6.0;
/// Two rays that pass this close may see one marker, mm (free-running cameras: 10 mm/s · 13 ms and noise).
pub const RAY_MISS_MM: f64 = 0.35;
/// Distances between markers are matched within this, mm.
pub const MARKER_DISTANCE_MM: f64 = 0.35;
/// A blob this close to a marker of a hypothesis supports it, px.
pub const ACQUISITION_GATE_PX: f64 = 6.0;
/// Speed assumed when sights of different instants meet in a search, mm/s.
pub const ACQUISITION_SPEED_MM_S: f64 = 25.0;
/// Points kept per search; more are clutter.
pub const ACQUISITION_POINTS: usize = 96;
/// Share of the best possible score at which a search ends.
pub const ACQUISITION_SCORE: f64 = 0.85;
/// Hypotheses tried per search: bounds its time.
pub const ACQUISITION_TRIALS: usize = 6_000;
/// Plausible hypotheses scored per search; scoring one costs 20 µs.
pub const ACQUISITION_SCORED: usize = 200;

const _: () = assert!(GROUP_NS * 4 < FIELD_PERIOD_NS, "a group never spans two fields of a camera");
const _: () = assert!(ACQUIRE_AFTER_NS < LOST_AFTER_NS);

/// A camera's turn since its calibration (standard deviation), rad: 8 µm at the distance of the tip. Wider, and the
/// turn of the eye is taken for one of the cameras.
pub const CAMERA_TURN_RAD: f64 = 1e-4;
/// Its shift, mm.
pub const CAMERA_SHIFT_MM: f64 = 0.04;
/// A marker's shift in its body per axis, mm.
pub const MARKER_SHIFT_MM: f64 = 0.003;
/// Share of the evidence that is kept at every solution (every second or so): two minutes of memory.
pub const DRIFT_KEPT: f64 = 0.995;
/// How far a solution moves the rig.
pub const DRIFT_STEP: f64 = 1.0;
/// Farthest that an unknown may go, in its standard deviations: beyond, the rig is to be calibrated.
pub const DRIFT_LIMIT: f64 = 10.0;
/// Evidence per unknown that noise, and hidden markers, may give.
pub const DRIFT_NOISE: f64 = 4.0;
/// Evidence per unknown above which the drift is called so.
pub const DRIFT_EVIDENCE: f64 = 10.0;
