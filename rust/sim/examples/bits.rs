//! Flies experiments and prints a digest of every signal's bits, one line each: two processors compute the same where the lines
//! are equal. `make bits` compares them.
//!
//! ```text
//! cargo run --release --example bits -- 20 configs/experiments/test1.toml configs/experiments/test2.toml
//! ```

use flight_sim::{Scenario, load_scenario};
use std::env::args;
use std::error::Error;
use std::ops::ControlFlow;
use std::path::Path;

/// 64-bit digest (FNV-1a) of the bits of all values.
fn digest(values: &[f64]) -> u64 {
    let bytes = values.iter().flat_map(|value| value.to_bits().to_le_bytes());
    bytes
        .fold(0xcbf2_9ce4_8422_2325, |digest, byte| (digest ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3))
}

fn main() -> Result<(), Box<dyn Error>> {
    let given: Vec<String> = args().skip(1).collect();
    let [duration, files @ ..] = given.as_slice() else {
        return Err("expected a duration [s] and files as in configs/experiments".into());
    };
    for file in files {
        let mut config = load_scenario(Path::new(file))?;
        config.simulator.duration = duration.parse()?;
        let flown = Scenario::new(&config)?.run(|_, _| ControlFlow::Continue(()))?;
        for series in &flown.log.series {
            println!("{file} {} {} {:016x}", series.signal.name, series.data.len(), digest(&series.data));
        }
    }
    Ok(())
}
