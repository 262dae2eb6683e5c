//! The text of a controller's TOML file: refused with words, or read.

#![no_main]

use flight_io::{ControllerSection, Schema, from_value, resolve_table, toml};
use libfuzzer_sys::fuzz_target;
use std::path::Path;

fuzz_target!(|text: &str| {
    let read = toml::parse(text, "fuzz.toml")
        .and_then(|table| resolve_table(table, Path::new("."), &Schema::of_type::<ControllerSection>()))
        .and_then(|value| from_value::<ControllerSection>(value, "fuzz.toml"));
    if let Err(refusal) = read {
        assert!(!refusal.to_string().trim().is_empty());
    }
});
