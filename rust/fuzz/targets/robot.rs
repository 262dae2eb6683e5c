//! A robot's TOML file and its URDF, separated by a zero byte: refused with words, or read.

#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|text: &str| {
    let (toml, urdf) = text.split_once('\0').unwrap_or((text, ""));
    if let Err(refusal) = flight_io::robot_from_text(toml, urdf, "fuzz.toml") {
        assert!(!refusal.to_string().trim().is_empty());
    }
});
