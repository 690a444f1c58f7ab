//! Makes many small recordings out of a few, for trying what scores thousands of them:
//!
//! ```sh
//! cargo run -p recording --example copies -- 1000 out/fleet a.mcap b.mcap
//! ```
//!
//! Copy I of N has the poses, events and steps of source I modulo the number of sources, and a seed
//! and a number of its own in its provenance, so that no two have the same content (SHA-256). Blobs,
//! checkpoints and pictures, of which no score is made, are left out.

use recording::{Item, Recording, RecordingError, Writer};
use std::error::Error;
use std::fs::File;
use std::path::{Path, PathBuf};

/// Topics that the score is made of.
const TOPICS: [&str; 3] = ["poses", "steps", "events"];

fn main() -> Result<(), Box<dyn Error>> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [count, folder, sources @ ..] = words.as_slice() else {
        return Err("usage: copies N FOLDER SOURCE.mcap...".into());
    };
    let (count, folder): (usize, PathBuf) = (count.parse()?, folder.into());
    std::fs::create_dir_all(&folder)?;
    for (number, source) in sources.iter().enumerate() {
        let recording = Recording::open(Path::new(source))?;
        let items = recording.items_of(&TOPICS).collect::<Result<Vec<_>, _>>()?;
        for copy in (number..count).step_by(sources.len()) {
            write(&recording, &items, copy, &folder.join(format!("{copy:05}.mcap")))?;
        }
    }
    println!("{count} recordings in {}", folder.display());
    Ok(())
}

/// Writes a copy under a name that is not taken.
fn write(from: &Recording, items: &[(u64, Item)], number: usize, file: &Path) -> Result<(), RecordingError> {
    let refused = |problem| RecordingError::Io { file: file.display().to_string(), problem };
    let mut provenance = from.provenance().clone();
    provenance.seeds.insert("cameras".into(), number.to_string());
    provenance.config.insert("copy".into(), number.to_string());
    let target = File::create_new(file).map_err(refused)?;
    let mut writer = Writer::on(target, file, &provenance)?;
    for (at, item) in items {
        writer.write(*at, item)?;
    }
    writer.finish()
}
