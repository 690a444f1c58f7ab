//! `poses RIG.json BLOBS.jsonl OUT.csv`: runs a blob stream through assembler and tracker on the
//! stream's own clock and writes the exchange format of poses; the time it took goes to stderr.
//! `--fixed-rig` trusts the rig file, `--covariance` adds status, blobs and the tip's covariance
//! (mm²).

use anyhow::Context;
use blob_stream::BlobReader;
use protocol::geometry::Validity;
use protocol::poses::{BODY_NAMES, BodyState, TrackerFrame};
use protocol::predict::predict;
use rig::Rig;
use std::io::Write;
use std::path::Path;
use tracker::Tracker;
use tracker::assembler::{ClosedFrame, FrameAssembler};

/// Time assumed between the newest field and the pose, ns.
const PROCESSING_NS: u64 = 1_000_000;

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, rig, blobs, out, rest @ ..] = arguments.as_slice() else {
        anyhow::bail!("usage: poses RIG.json BLOBS.jsonl OUT.csv [--fixed-rig] [--covariance]");
    };
    let estimate_drift = !rest.iter().any(|a| a == "--fixed-rig");
    let covariance = rest.iter().any(|a| a == "--covariance");
    let rig = Rig::load(Path::new(rig))?;
    let mut run = Run {
        tracker: Tracker::with(&rig, estimate_drift),
        assembler: FrameAssembler::new(&rig),
        out: std::io::BufWriter::new(std::fs::File::create(out).with_context(|| out.clone())?),
        took_ns: Vec::new(),
        display: 0,
        last: None,
        covariance,
    };
    write!(run.out, "t_ns,t_out_ns,body,valid,x,y,z,qw,qx,qy,qz,kind")?;
    writeln!(
        run.out,
        "{}",
        if covariance { ",status,blobs,residual_px,pxx,pxy,pxz,pyy,pyz,pzz" } else { "" }
    )?;
    let mut newest_ns = 0;
    for field in BlobReader::open(Path::new(blobs))? {
        let field = field?;
        newest_ns = field.blobs_out_ns.max(newest_ns);
        while let Some(closed) = run.assembler.expired(newest_ns) {
            run.frame(&closed)?;
        }
        if let Err(refusal) = run.assembler.push(&field, newest_ns) {
            eprintln!("{refusal}");
        }
        while let Some(closed) = run.assembler.complete(newest_ns) {
            run.frame(&closed)?;
        }
    }
    while let Some(closed) = run.assembler.flush(newest_ns) {
        run.frame(&closed)?;
    }
    eprintln!("{:?}", run.tracker.drift());
    run.took_ns.sort_unstable();
    let n = run.took_ns.len().max(1);
    let mean = run.took_ns.iter().sum::<u64>() as f64 / n as f64;
    let at = |p: f64| run.took_ns.get((p * (n - 1) as f64) as usize).map_or(0.0, |t| *t as f64 * 1e-3);
    eprintln!(
        "{n} frames, µs: mean {:.1}, p50 {:.1}, p99 {:.1}, max {:.1}",
        mean * 1e-3,
        at(0.5),
        at(0.99),
        at(1.0)
    );
    Ok(())
}

struct Run {
    tracker: Tracker,
    assembler: FrameAssembler,
    out: std::io::BufWriter<std::fs::File>,
    took_ns: Vec<u64>,
    display: u64,
    last: Option<(u64, TrackerFrame)>,
    covariance: bool,
}

impl Run {
    fn frame(&mut self, closed: &ClosedFrame) -> anyhow::Result<()> {
        let begin = std::time::Instant::now();
        let frame = self.tracker.track(self.assembler.used(), &closed.reference);
        self.took_ns.push(begin.elapsed().as_nanos() as u64);
        let received = self.assembler.used().iter().map(|f| f.blobs_out_ns).max().unwrap_or(0);
        let t_out_ns = received + PROCESSING_NS;
        self.display_until(t_out_ns)?;
        for (name, body) in BODY_NAMES.iter().zip(&frame.bodies) {
            let valid = body.validity() == Validity::Measured && body.blobs_used > 0;
            self.row([frame.instants.exposed, t_out_ns], name, valid, body, "meas")?;
        }
        self.last = Some((t_out_ns, frame));
        Ok(())
    }

    /// What a display at 85 Hz would have shown before `until_ns`, latched 15 ms earlier.
    fn display_until(&mut self, until_ns: u64) -> anyhow::Result<()> {
        loop {
            let shown_ns = (self.display as f64 / 85.0 * 1e9) as u64;
            let latched_ns = shown_ns.saturating_sub(15_000_000);
            if latched_ns >= until_ns {
                return Ok(());
            }
            self.display += 1;
            let Some((_, frame)) = self.last else { continue };
            for (b, name) in BODY_NAMES.iter().enumerate() {
                let predicted = predict(&frame, b, shown_ns);
                let mut body = frame.bodies[b];
                body.world_from_body = predicted.world_from_body;
                let valid = predicted.validity != Validity::Lost;
                self.row([shown_ns, latched_ns], name, valid, &body, "pred")?;
            }
        }
    }

    fn row(
        &mut self,
        t: [u64; 2],
        name: &str,
        valid: bool,
        body: &BodyState,
        kind: &str,
    ) -> anyhow::Result<()> {
        let [x, y, z] = body.world_from_body.position_mm;
        let [qw, qx, qy, qz] = body.world_from_body.rotation_wxyz;
        let valid = u8::from(valid);
        write!(
            self.out,
            "{},{},{name},{valid},{x:.7},{y:.7},{z:.7},{qw:.9},{qx:.9},{qy:.9},{qz:.9},{kind}",
            t[0], t[1]
        )?;
        if self.covariance {
            write!(self.out, ",{},{},{:.3}", body.status, body.blobs_used, body.residual_px)?;
            for entry in [0, 1, 2, 6, 7, 11] {
                write!(self.out, ",{:e}", body.covariance[entry])?;
            }
        }
        writeln!(self.out)?;
        Ok(())
    }
}
