//! A recorded reference: refused with words, or read.

#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|text: &str| {
    if let Err(refusal) = flight_io::mission::parse_recording(text, "fuzz.csv") {
        assert!(!refusal.to_string().trim().is_empty());
    }
});
