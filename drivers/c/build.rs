//! Names the shared library: programs that link against it ask for this name when they start, whatever the version.

/// Raised whenever a program that was compiled against an earlier `vitreo.h` would no longer work.
const ABI: u32 = 0;

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rustc-cdylib-link-arg=-Wl,-soname,libvitreo.so.{ABI}");
}
