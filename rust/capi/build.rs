//! Names the shared library by its interface, of which patches are: programs then need `libflight.so.MAJOR.MINOR`.

use std::env::var;
use std::path::Path;

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    let of = |name| var(name).unwrap_or_default();
    if of("CARGO_CFG_TARGET_OS") != "linux" {
        return;
    }
    let name = format!("libflight.so.{}.{}", of("CARGO_PKG_VERSION_MAJOR"), of("CARGO_PKG_VERSION_MINOR"));
    println!("cargo::rustc-cdylib-link-arg=-Wl,-soname,{name}");
    // Programs that are linked with the library in cargo's own folders find it by this name.
    #[cfg(unix)]
    for profile in Path::new(&of("OUT_DIR")).ancestors().skip(3).take(1) {
        for folder in [profile, &profile.join("deps")] {
            drop(std::os::unix::fs::symlink("libflight.so", folder.join(&name)));
        }
    }
}
