//! Proofs of vitreo that no program of it contains. What proves what:
//!
//! | subject | proof |
//! |---|---|
//! | springs, membranes, volume elements, adhesion, blebs | [`closed_form`]: closed forms and independent solutions; `tests/truth.rs`, example `validation`, `docs/validation.md` |
//! | collision | [`rays`]: exact rational arithmetic; `tests/agreement.rs` (processor), `tests/gpu.rs` (adapter), example `collision_agreement`, `docs/collision.md` |
//! | pairs of triangles in contact | [`exact`]: whole numbers; bench `collision`, example `collision_agreement` |
//! | peeling force | `tests/peel.rs`, example `peel_force`, `docs/peeling.md` |
//! | finite numbers, bounded energy, whole meshes, determinism | [`soak`]: random programmes over random scenes; `tests/soak.rs`, example `soak` (`make soak`) |
//! | cameras, tracker, simulation and score together | [`pipeline`]: a live run in one process; example `study` (`make study`, `docs/study.md`), `tests/scenarios/modules.rs` of the workspace |
//! | pictures of scenes and modules | [`moments`]: example `gallery` (`make pictures`, `make gallery`), `tests/scenarios/pictures.rs` of the workspace |
//! | tracking of unseen streams, knocked cameras | [`streams`]: drawn streams with truth; examples `unseen`, `knocked`, `docs/tracking.md` |
//! | causes of residuals | [`planted`]: drawn streams with a defect; `tests/causes.rs`, example `causes`, `docs/calibration.md` |
//! | roll of instruments | example `rolls`, `docs/tracking.md` |
//! | the paper's Fig. 7 | example `teapot`, `docs/collision.md` |
//! | causes that `vitreo diff` names | [`defects`]: planted defects; `tests/defects.rs`, example `defects` (`make defects`), `docs/diff.md` |
//! | speed beside other methods | benches `collision`, `tissue`, `vitreous` |

pub mod camera_twin;
pub mod closed_form;
pub mod compiled;
pub mod defects;
pub mod exact;
pub mod judged;
pub mod live_recording;
pub mod moments;
pub mod pipeline;
pub mod planted;
pub mod rays;
pub mod soak;
pub mod stability;
pub mod streams;
