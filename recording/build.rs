//! Compiles the recording's protobuf messages and their descriptors, without `protoc`.

use protox::prost::Message;
use std::{env, error::Error, fs, path::PathBuf};

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo:rerun-if-changed=proto/vitreo.proto");
    let out = PathBuf::from(env::var_os("OUT_DIR").ok_or("OUT_DIR is not set")?);
    let mut files = protox::compile(["vitreo.proto"], ["proto"])?;
    prost_build::Config::new().compile_fds(files.clone())?;
    // The recording carries the descriptors; comments would only make every file larger.
    for file in &mut files.file {
        file.source_code_info = None;
    }
    fs::write(out.join("vitreo.descriptors"), files.encode_to_vec())?;
    Ok(())
}
