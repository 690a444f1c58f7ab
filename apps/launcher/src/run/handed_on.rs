//! Arguments of each process, derived from a run's options.

use super::controls::left;
use super::options::{RunArgs, View};
use protocol::budget::Stage;
use protocol::file::STDIN;
use protocol::health::Process;
use settings::commands::processes::{Arguments, PictureArgs, VirtualRigArgs};
use std::path::PathBuf;

/// Camera that `--inject-delay camera-wait=MS` delays.
const LATE_CAMERA: u32 = 2;

impl RunArgs {
    /// Arguments of a process. `remaining_s` is the rest of the run's duration, s; `restarts` is the number
    /// of restarts of this process so far.
    pub fn arguments_of(
        &self,
        process: Process,
        view: View,
        remaining_s: Option<f64>,
        restarts: u32,
    ) -> Vec<String> {
        let mut args = Arguments::default();
        if process == Process::PosesDriver {
            let other = self.real.poses.as_ref();
            args.value("--from", other.map(|other| format!("igtl:{}", other.server)));
            args.path("--map", other.and_then(|other| other.map.as_ref()));
            return args.0;
        }
        let real = process == Process::VirtualRig && self.real.given().is_some();
        // The user's own camera program knows no scenes.
        let others = real && self.real.program().is_some();
        if process != Process::Simcore {
            self.rig.hand_on(&mut args);
        }
        if !others && !matches!(process, Process::FpgaModel | Process::Tracker) {
            self.scene.hand_on(&mut args);
        }
        args.value("--inject-delay-ms", self.delayed_stage(process).and_then(|stage| self.delay_ms(stage)));
        // External programs for real cameras write no traces.
        args.value("--trace-spans", self.outputs.trace.spans().filter(|_| !real));
        match process {
            driver if driver.drives().is_some() => {}
            Process::VirtualRig if real => {
                if let Some(streams) = self.real.streams() {
                    args.value("--cameras", Some(streams));
                    args.value("--leave", left(self));
                    args.value("--duration", remaining_s);
                }
            }
            Process::VirtualRig => self.to_virtual_rig(&mut args, remaining_s, restarts),
            Process::Renderer => self.to_renderer(&mut args, view, restarts),
            Process::Simcore => self.collision.hand_on(&mut args),
            Process::FpgaModel => self.extraction.hand_on(&mut args),
            Process::Tracker => {}
            Process::Controls => self.controls.hand_on(&mut args),
            _ => self.desk.iter().for_each(|desk| desk.hand_on(&mut args)),
        }
        args.0
    }

    /// The stage whose injected delay this process applies.
    fn delayed_stage(&self, process: Process) -> Option<Stage> {
        match process {
            Process::VirtualRig if self.real.given().is_some() => None,
            // With pixels, the camera hardware sends the blobs and is delayed; without pixels, the rig sends
            // the blobs.
            Process::VirtualRig if self.trackers().contains(&Process::FpgaModel) => None,
            Process::VirtualRig | Process::FpgaModel => Some(Stage::Camera),
            // A desk waits for no cameras; its work counts as tracking.
            Process::Tracker | Process::Desk => Some(Stage::Tracking),
            Process::Simcore => Some(Stage::Simulation),
            Process::Renderer => Some(Stage::Rendering),
            _ => None,
        }
    }

    /// Injected delay of a stage, ms.
    fn delay_ms(&self, stage: Stage) -> Option<f64> {
        self.trial.inject_delay.iter().rev().find(|(s, _)| *s == stage).map(|(_, ms)| *ms)
    }

    fn to_virtual_rig(&self, args: &mut Arguments, remaining_s: Option<f64>, restarts: u32) {
        let fault_log = self.numbered_option(self.virtual_rig.fault_log.as_ref(), restarts);
        args.flag("--force", self.outputs.force.force && fault_log.is_some());
        // The standard input of a child is closed, so the child opens that of the launcher.
        let ours = || format!("/proc/{}/fd/0", std::process::id()).into();
        let is_stdin = |blobs: &PathBuf| blobs.as_os_str() == STDIN;
        let blobs = self.virtual_rig.blobs.clone().map(|blobs| if is_stdin(&blobs) { ours() } else { blobs });
        VirtualRigArgs { fault_log, blobs, ..self.virtual_rig.clone() }.hand_on(args);
        args.value("--leave", left(self));
        args.value("--duration", remaining_s);
        args.value("--after-round", self.after_round);
        let late = self.delay_ms(Stage::CameraWait).map(|ms| format!("{LATE_CAMERA}={ms}"));
        args.value("--late-camera", late);
    }

    /// A restarted renderer writes new, numbered files: `a-2.y4m`.
    fn to_renderer(&self, args: &mut Arguments, view: View, restarts: u32) {
        args.flag(if view == View::Window { "--window" } else { "--headless" }, true);
        args.flag("--desk", self.desk.is_some());
        let picture = &self.view.picture;
        let picture = PictureArgs {
            stills: self.numbered_option(picture.stills.as_ref(), restarts),
            video: self.numbered_option(picture.video.as_ref(), restarts),
            lose_device_after: picture.lose_device_after.filter(|_| restarts == 0),
            ..picture.clone()
        };
        args.flag(
            "--force",
            self.outputs.force.force && (picture.stills.is_some() || picture.video.is_some()),
        );
        picture.hand_on(args);
    }

    fn numbered_option(&self, file: Option<&PathBuf>, restarts: u32) -> Option<PathBuf> {
        file.map(|file| self.numbered(file, restarts))
    }
}
