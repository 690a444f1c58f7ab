//! Every tuning constant of the tracker: value, unit, and what breaks when it is moved.

use crate::tremor_bank::Band;

/// Default standard deviation of a blob's column for an area of 1 px, px. The centre is a mean over
/// the area, so it falls with the root of the area (measured: 0.046 px at 175 px, 0.033 px at 350
/// px).
pub const SIGMA_X_PX: f64 = 0.61;
/// The same for its line in the frame, px: a line of a field is two lines of the frame.
pub const SIGMA_Y_PX: f64 = 1.2;
/// Areas between which that rule holds, px of the field.
pub const SIGMA_AREA_PX: (f64, f64) = (20.0, 600.0);
/// Bounds of the variances of a stream, px².
pub const VARIANCE_RANGE_PX2: (f64, f64) = (1e-6, 1e4);
/// Tolerance of the logarithm of the ratio of areas of a fully visible marker.
pub const AREA_TOLERANCE: f64 = 0.04;
/// Shift of the centre of a partly hidden marker, in radii per unit of that logarithm.
pub const AREA_SHIFT: f64 = 0.8;
/// Length of a shaft from its tip that may hide markers, mm: as much of it as lies in the eye.
pub const SHAFT_IN_EYE_MM: f64 = 22.0;
/// Largest standard deviation of the shift of a marker that something is predicted to hide in part, radii.
pub const COVERED_SHIFT: f64 = 0.6;
/// Of the share that is predicted to be hidden, what at least must miss in a blob's area, and its tolerance.
pub const COVERED_AREA: (f64, f64) = (0.3, 0.02);
/// Distance of two markers of a colour, in sums of their radii, below which they may be one blob.
pub const TOUCHING: f64 = 1.15;
/// Largest logarithm of the ratio of the area of such a blob to that of both markers.
pub const MERGED_AREA: f64 = 0.06;
/// Range of the ratio of areas of a blob and its marker.
pub const AREA_RATIO: (f64, f64) = (0.15, 1.7);
/// The same range before the camera's scale of areas is estimated.
pub const ACQUISITION_AREA_RATIO: (f64, f64) = (0.3, 2.2);
/// Step of the running estimate of a camera's area scale.
pub const AREA_SCALE_STEP: f64 = 0.004;

/// Initial standard deviation of the voluntary acceleration, mm/s².
pub const VOLUNTARY_MM_S2: f64 = 15.0;
/// Time constant of its lags, s: shorter fits noise as movement, longer lags behind movement above 1/2πτ.
pub const VOLUNTARY_TAU_S: f64 = 0.2;
/// Bounds of its adaptive variance, mm²/s⁴: an instrument at rest, one that is withdrawn.
pub const VOLUNTARY_RANGE_MM2_S4: (f64, f64) = (25.0, 1e5);
/// Time constant of its adaptation, s.
pub const VOLUNTARY_LEARNING_S: f64 = 0.3;
/// Time between the instants at which a withdrawal may have begun, s; the oldest is 0.1 s back. By then a minimum-jerk
/// movement of 25 mm in 0.9 s has moved the tip by 0.3 mm.
pub const ONSET_SPACING_S: f64 = 0.02;
/// Twice the logarithm of the likelihood ratio that shows a withdrawal: five standard deviations of the jerk.
pub const ONSET_RATIO: f64 = 25.0;
/// Standard deviation of the jerk of a withdrawal, mm/s³: that movement begins with 2,100.
pub const ONSET_JERK_MM_S3: f64 = 3000.0;
/// Time for which the jerk is expected to raise the acceleration, s.
pub const ONSET_RISE_S: f64 = 0.1;
/// Share of a raise of that variance at a manoeuvre that acceleration and lags get at once.
pub const MANOEUVRE_SHARE: f64 = 0.1;
/// Bounds of the ratio of two levers by which the tremor is scaled at once.
pub const LEVER_RATIO: (f64, f64) = (0.2, 5.0);
/// NIS (normalised innovation squared, 6 degrees of freedom) that indicates a manoeuvre.
pub const NIS_LIMIT: f64 = 30.0;
/// Least number of near misses, and more than matches, that indicates a manoeuvre.
pub const MIN_NEAR_MISSES: usize = 2;
/// Least number of blobs that the fit of an instrument leaves unexplained, after which a wider prediction is tried.
pub const MIN_UNEXPLAINED: usize = 2;
/// Least ratio of their number to that of the blobs which the fit explains.
pub const UNEXPLAINED_SHARE: f64 = 0.2;
/// Standard deviations added to the tip's position (mm), velocity (mm/s) and acceleration (mm/s²)
/// at a manoeuvre.
pub const INFLATION: [f64; 3] = [0.05, 3.0, 100.0];
/// Running ratio of the NIS to its expectation that indicates a manoeuvre.
pub const NIS_RATIO_LIMIT: f64 = 1.7;
/// Gain of that running ratio.
pub const NIS_RATIO_GAIN: f64 = 0.15;
/// Bands of the tremor: physiological tremor lies between 6 and 14 Hz, most of it between 8 and 12. More pole pairs
/// predict better and cost time. An unknown hand is taken to tremble in the middle band alone: a band that begins empty and
/// is not takes half a second to show in the NIS (see below), one that begins full and is empty takes four seconds to be
/// known.
pub const TREMOR_BANDS: [Band; 3] = [
    Band { low_hz: 6.0, high_hz: 8.0, pairs: 3, start_mm: 0.002 },
    Band { low_hz: 8.0, high_hz: 12.0, pairs: 6, start_mm: 0.05 },
    Band { low_hz: 12.0, high_hz: 14.0, pairs: 3, start_mm: 0.002 },
];
/// The one in which most tremor is.
pub const MAIN_TREMOR_BAND: usize = 1;
/// Time after which a hand is known, ns; before it, a large NIS shows that it trembles in all bands.
pub const UNKNOWN_HAND_NS: u64 = 1_000_000_000;
/// NIS of an update, and its running ratio, that show so.
pub const UNKNOWN_HAND_NIS: (f64, f64) = (60.0, 2.5);
/// Ripple of a band, dB: less has gentler slopes.
pub const TREMOR_RIPPLE_DB: f64 = 4.0;
/// The same for the roll, whose tremor is nearer to its noise: fewer and wider.
pub const ROLL_TREMOR_HZ: [f64; 3] = [8.0, 10.0, 12.0];
/// Their damping ratio.
pub const ROLL_TREMOR_DAMPING: f64 = 0.05;
/// Initial standard deviation of their angle, rad.
pub const ROLL_TREMOR_START_RAD: f64 = 0.003;
/// Bounds of its adaptive variance, rad².
pub const ROLL_TREMOR_RANGE_RAD2: (f64, f64) = (1e-8, 0.01);
/// Bounds of its adaptive variance, mm².
pub const TREMOR_RANGE_MM2: (f64, f64) = (1e-7, 0.04);
/// Least share of a band that the blobs are taken to determine.
pub const LEAST_KNOWN: f64 = 0.1;
/// Time constant of its adaptation, s.
pub const TREMOR_LEARNING_S: f64 = 0.3;
/// Natural frequency of the play of a shaft in its trocar, rad/s.
pub const PLAY_RAD_S: f64 = 3.0;
/// Its damping ratio.
pub const PLAY_DAMPING: f64 = 0.7;
/// Play where the trocar is unknown, mm.
pub const FREE_PLAY_MM: f64 = 1.0;
/// Distance of the pivot from the tip where the trocar is unknown, mm.
pub const FREE_PIVOT_MM: f64 = 12.0;
/// Speed along the shaft at which an instrument counts half as being put in or taken out, mm/s; guided, it is moved
/// with some 5.
pub const INSERTION_MM_S: f64 = 20.0;
/// Insertions of a smaller weight are neglected.
pub const LEAST_INSERTION: f64 = 1e-3;
/// So are those at a shorter lever, mm.
pub const SHORTEST_INSERTION_MM: f64 = 2.0;
/// Lever below which a shaft that finds its trocar was put into it, mm; above it the eye was found again.
pub const JUST_PUT_IN_MM: f64 = 8.0;
/// Standard deviation of the turn of a shaft that was just put in, rad/s; times the lever, it gives the tip's speed across.
pub const PUT_IN_TURN_RAD_S: f64 = 0.4;
/// Least distance of tip and pivot that gives a direction, mm.
pub const SHORTEST_LEVER_MM: f64 = 4.0;
/// Longest step of the filter's prediction, ns.
pub const LONGEST_STEP_NS: u64 = 30_000_000;
/// Least distance from the shaft of a marker that observes the roll, mm.
pub const ROLL_LEVER_MM: f64 = 0.3;
/// Largest standard deviation of a blob that observes the roll, px.
pub const ROLL_LOCALISED_PX: f64 = 1.0;
/// Tolerance of votes for one roll, rad: noise, a drift of the rig by a third of a pixel, and 1 ms
/// between cameras at 10 rad/s.
pub const ROLL_AGREES_RAD: f64 = 0.06;
/// Tolerance of the first distance of a blob from the ring of its marker, in radii: the ring is
/// only nearly an ellipse.
pub const ROLL_RING: f64 = 0.3;
/// Least ratio of axes of a ring; a flatter one is seen from the side, and front and back are
/// ambiguous.
pub const ROLL_FLAT: f64 = 0.15;
/// Standard deviation of the roll's acceleration in a manoeuvre, rad/s²: fingers that turn a handle
/// by 45° in a quarter of a second reach 75 (minimum jerk).
pub const ROLL_MANOEUVRE_RAD_S2: f64 = 150.0;
/// Bounds of the duration of such a manoeuvre, s.
pub const ROLL_MANOEUVRE_S: (f64, f64) = (0.02, 0.04);
/// Time without an observation after which the roll is damped, ns.
pub const ROLL_COAST_NS: u64 = 150_000_000;
/// Time constant of that damping, s.
pub const ROLL_DAMPING_S: f64 = 0.2;
/// Standard deviation of the Singer acceleration of an instrument's roll, rad/s².
pub const TURN_ACCELERATION_RAD_S2: f64 = 8.0;
/// Its time constant, s.
pub const TURN_ACCELERATION_TAU_S: f64 = 0.1;
/// The same for the eye's rotation, rad/s².
pub const EYE_ACCELERATION_RAD_S2: f64 = 0.15;
/// Its time constant, s.
pub const EYE_ACCELERATION_TAU_S: f64 = 0.7;
/// Largest factor on it after a large NIS, and the time constant of its decay, s.
pub const EYE_BOOST: (f64, f64) = (30.0, 0.3);
/// Initial standard deviation of the velocity of an instrument, mm/s: it is put in with some 30.
pub const START_SPEED_MM_S: f64 = 30.0;
/// The same across the shaft of one that is found again, mm/s.
pub const START_SPEED_ACROSS_MM_S: f64 = 10.0;
/// Standard deviation of the voluntary acceleration along that shaft, mm/s²: at the retina it stops within some tenths of a
/// second. Across, it is that of any movement.
pub const START_ACCELERATION_MM_S2: f64 = 150.0;
/// Initial standard deviation of the roll rate of an instrument, rad/s.
pub const START_TURN_RAD_S: f64 = 1.5;
/// Initial standard deviation of the angular velocity of the eye, rad/s.
pub const START_EYE_TURN_RAD_S: f64 = 0.5;
/// The eye's centre is the origin: standard deviation of its position, mm.
pub const EYE_CENTRE_MM: f64 = 1e-4;

/// Camera-fields this close belong to one update, ns, at most a quarter of a period; genlocked cameras differ by
/// 0.1 ms.
pub const GROUP_NS: u64 = 1_000_000;
/// Greatest age of a field used for acquisition, in quarters of a period (of 20 ms at least; see
/// [`crate::rate_constants`], also for the others).
pub const ACQUISITION_QUARTERS: u64 = 5;
/// Time after its last blob for which a camera counts as seeing a body.
pub const SEEN_QUARTERS: u64 = 6;
/// Time after two cameras saw a body for which one camera alone still measures it: the pivot of the shaft
/// determines the depth until the play becomes too uncertain.
pub const ONE_CAMERA_QUARTERS: u64 = 9;
/// Time without two cameras after which a body is lost, ns. Found again, it is as uncertain as if it had never been seen; how a
/// hand moves is known for longer than two cameras are silent.
pub const LOST_AFTER_NS: u64 = 250_000_000;
/// The same for an instrument that turns freely: taken out, it may come back anywhere, and a prediction that goes on takes its
/// markers for one another.
pub const FREE_LOST_AFTER_NS: u64 = 150_000_000;
/// Time without two cameras after which a body is searched, in quarters of a period.
pub const ACQUIRE_AFTER_QUARTERS: u64 = 6;
/// Gap (or step back) between camera-fields after which all tracks end, ns.
pub const MAX_GAP_NS: u64 = 500_000_000;

/// Gate: squared Mahalanobis distance of a blob from a predicted marker. Hands do what no spectrum says: a narrower
/// one takes the onset of a movement for a manoeuvre, a wider one lets clutter in.
pub const GATE: f64 = 50.0;
/// Largest distance of a blob from a predicted marker, px.
pub const GATE_PX: f64 = 40.0;
/// Squared normalised residual above which a blob is an outlier of a fit.
pub const OUTLIER: f64 = 20.0;
/// Distance from a marker within which an unassigned blob of its colour is a near miss, px.
pub const NEAR_PX: f64 = 5.0;
/// Blobs kept per outlier or near miss, below which the status is interference.
pub const INTERFERENCE_SHARE: u32 = 4;
/// Squared residual of half weight in the robust iteration.
pub const ROBUST_SCALE: f64 = 9.0;
/// Reduced χ² above which a fit is refused.
pub const BAD_FIT: f64 = 9.0;
/// Bounds of a body's running reduced χ² (drifted calibration raises it).
pub const CHI2_RANGE: (f64, f64) = (1.0, 30.0);
/// Step of that running estimate.
pub const CHI2_STEP: f64 = 0.05;
/// Largest standard deviation of a measured tip, mm.
pub const MEASURED_MM: f64 = 0.08;
/// Largest standard deviation of a measured rotation, rad.
pub const MEASURED_RAD: f64 = 0.5;
/// Largest distance of a shaft from its trocar, mm.
pub const TROCAR_MISS_MM: f64 = 1.0;

/// Factor on the variances of blobs in acquisition: the rig may have drifted by a third of a pixel.
pub const ACQUISITION_VARIANCE: f64 = 6.0;
/// Largest distance of two rays to one marker, mm (free-running cameras: 10 mm/s · 13 ms, and
/// noise).
pub const RAY_MISS_MM: f64 = 0.35;
/// Tolerance of distances between markers, mm.
pub const MARKER_DISTANCE_MM: f64 = 0.35;
/// Distance within which a blob supports a marker of a hypothesis, px.
pub const ACQUISITION_GATE_PX: f64 = 6.0;
/// Speed assumed between fields of different instants, mm/s.
pub const ACQUISITION_SPEED_MM_S: f64 = 25.0;
/// Most triangulated points per search; more are clutter.
pub const ACQUISITION_POINTS: usize = 96;
/// Fraction of the best possible score at which a search ends.
pub const ACQUISITION_SCORE: f64 = 0.85;
/// Most hypotheses per search; bounds its time.
pub const ACQUISITION_TRIALS: usize = 6_000;
/// Most hypotheses scored per search; each costs 20 µs.
pub const ACQUISITION_SCORED: usize = 200;

/// Standard deviation of a camera's rotation since its calibration, rad: 8 µm at the distance of
/// the tip. A larger one takes rotations of the eye for rotations of the cameras.
pub const CAMERA_TURN_RAD: f64 = 1e-4;
/// Standard deviation of its translation, mm.
pub const CAMERA_SHIFT_MM: f64 = 0.04;
/// Standard deviation of a marker's shift in its body per axis, mm.
pub const MARKER_SHIFT_MM: f64 = 0.003;
/// Forgetting factor per solution (every second or so): two minutes of memory.
pub const DRIFT_KEPT: f64 = 0.995;
/// Gain of a solution on the rig.
pub const DRIFT_STEP: f64 = 1.0;
/// Bound of a parameter, in its standard deviations; beyond it the rig must be calibrated.
pub const DRIFT_LIMIT: f64 = 10.0;
/// Evidence per parameter from noise and hidden markers.
pub const DRIFT_NOISE: f64 = 4.0;
/// Evidence per parameter above which drift is detected.
pub const DRIFT_EVIDENCE: f64 = 10.0;

/// Prior standard deviation, and unit, of the turn of a camera that was moved, rad: 8 px.
pub const KNOCK_TURN_RAD: f64 = 5e-3;
/// Prior standard deviation, and unit, of its shift, mm.
pub const KNOCK_SHIFT_MM: f64 = 0.5;
/// Largest distance of a moved blob from its predicted marker, px; beyond it another marker's blob
/// is nearer.
pub const KNOCK_REACH_PX: f64 = 16.0;
/// Mean distance of the blobs of a field from their predictions above which the field jumps, px.
pub const KNOCK_JUMP_PX: f64 = 0.8;
/// Largest predicted variance of the eye's markers at which a jump can be detected, px².
pub const KNOCK_SURE_PX2: f64 = 0.1;
/// Least number of markers that show a jump.
pub const KNOCK_JUMP_MARKERS: usize = 5;
/// Largest distance of a blob from the common turn and shift of its field, px.
pub const KNOCK_AGREES_PX: f64 = 1.0;
/// Weight of a blob in that turn and shift, px⁻²: a standard deviation of 0.2 px.
pub const KNOCK_WEIGHT: f64 = 25.0;
/// Fields of a camera that jump in a row after which it is left out; this and the other numbers of fields and
/// gains are those at 50 Hz (see [`crate::rate_constants`]).
pub const KNOCK_FIELDS: u32 = 5;
/// Time within which jumps of two cameras show a wrong prediction and not a moved camera, in quarters of a
/// period.
pub const KNOCK_TOGETHER_QUARTERS: u64 = 5;
/// Fields without a jump after which a suspected camera is trusted.
pub const KNOCK_CALM_FIELDS: u32 = 3;
/// Time constant of the evidence about a camera, ns: a shorter one misses small shifts.
pub const KNOCK_MEMORY_NS: f64 = 0.3e9;
/// Residual of half weight in that evidence, px; smaller, and a shift of 3 px weighs less than what
/// it does to the other cameras.
pub const KNOCK_SLOW_PX: f64 = 2.0;
/// Largest residual in that evidence, px.
pub const KNOCK_SLOW_REACH_PX: f64 = 6.0;
/// Least number of fields in that evidence.
pub const KNOCK_LEAST_FIELDS: f64 = 8.0;
/// Least decrease of χ² that shows a moved camera.
pub const KNOCK_GAIN: f64 = 100.0;
/// Least decrease of χ² per blob that shows one. Blobs of partly covered markers are off in one direction by less
/// than their standard deviation: 0.9 on a calibrated rig; at least 2.4 where a picture moved by 0.3 px.
pub const KNOCK_GAIN_PER_BLOB: f64 = 1.5;
/// Expected decrease of χ² above which a body must agree.
pub const KNOCK_BODY_GAIN: f64 = 16.0;
/// Least shift of the picture that shows a moved camera, px; calibrations are off by up to 0.1 px.
pub const KNOCK_LEAST_PX: f64 = 0.15;
/// Time within which the remaining cameras can refute that a camera was moved, ns.
pub const KNOCK_TRIAL_NS: u64 = 700_000_000;
/// Time after a camera was left out in which no evidence is taken, ns: the filters still follow it.
pub const KNOCK_SETTLE_NS: u64 = 150_000_000;
/// Time without a judgement after the cameras disagreed, ns.
pub const KNOCK_QUIET_NS: u64 = 30_000_000_000;
/// Time after that in which cameras that still disagree show it again, ns: each is tried.
pub const KNOCK_AGAIN_NS: u64 = 5_000_000_000;
/// Time after a camera was left out at which its resection begins, ns.
pub const RESECTION_AFTER_NS: u64 = 100_000_000;
/// Fields after which a resected pose is used where fewer than two other cameras send.
pub const RESECTION_PROVISIONAL_FIELDS: u64 = 20;
/// Time without a field after which a camera does not count as sending, in quarters of a period.
pub const SILENT_QUARTERS: u64 = 10;
/// Least number of fields of a resection.
pub const RESECTION_FIELDS: u64 = 80;
/// Time after which a camera whose resection does not settle counts as moving, ns.
pub const RESECTION_LONGEST_NS: u64 = 6_000_000_000;
/// Markers kept for a resection; more take longer than a field may.
pub const RESECTION_SIGHTINGS: usize = 1_600;
/// Newest fields by which a resection is checked.
pub const RESECTION_CHECKED: usize = 25;
/// Largest distance of a blob from the resected image of its marker, px.
pub const RESECTION_REACH_PX: f64 = 4.0;
/// Residual of half weight in a resection, px.
pub const RESECTION_SCALE_PX: f64 = 0.5;
/// Largest mean offset, and change of it, of the checked fields, px.
pub const RESECTION_STEADY_PX: f64 = 0.12;
/// Updates without the eye after which it is searched without each of the cameras.
pub const WITHOUT_EYE_UPDATES: u32 = 6;
/// Updates without the eye, though two cameras see its markers, after which the cameras disagree.
pub const DISAGREE_UPDATES: u32 = 60;
/// Root mean square residual of an eye found without a camera, at most, px. Where the eye is found with all of them and
/// leaves more, it is searched so at once; one that turns while the cameras expose leaves half of it.
pub const WITHOUT_CAMERA_PX: f64 = 1.0;
/// Least ratio to it of the next best, without another camera.
pub const WITHOUT_CAMERA_RATIO: f64 = 1.5;
