//! Numbers that tests compare with their tolerances, written down for the summary at the end of `make test`.

#![allow(clippy::unwrap_used, reason = "a measurement that cannot be written down fails its test")]

use nalgebra::{Dim, Matrix, RawStorage};
use std::collections::HashMap;
use std::fs::{File, create_dir_all};
use std::io::Write;
use std::ops::Sub;
use std::panic::Location;
use std::path::PathBuf;
use std::sync::{LazyLock, Mutex};

/// The file of this process, and the largest fraction of its tolerance that each place has used.
type Measurements = (File, HashMap<Location<'static>, f64>);

/// Greatest component of a value.
pub trait Size {
    fn size(&self) -> f64;
}

impl Size for f64 {
    fn size(&self) -> f64 {
        self.abs()
    }
}

impl<R: Dim, C: Dim, S: RawStorage<f64, R, C>> Size for Matrix<f64, R, C, S> {
    fn size(&self) -> f64 {
        self.iter().fold(0.0, |size, x| size.max(x.abs()))
    }
}

/// Greatest component of the difference of two values.
pub fn difference<T: Size + Sub<Output = T>>(found: T, expected: T) -> f64 {
    (found - expected).size()
}

/// Their difference as a fraction of the larger of the two.
pub fn relative<T: Size + Sub<Output = T>>(found: T, expected: T) -> f64 {
    let size = found.size().max(expected.size());
    if size == 0.0 { 0.0 } else { difference(found, expected) / size }
}

/// Written to the folder `MEASURED`; `None` where no summary is wanted.
static MEASUREMENTS: LazyLock<Option<Mutex<Measurements>>> = LazyLock::new(|| {
    let folder = PathBuf::from(std::env::var_os("MEASURED")?);
    create_dir_all(&folder).unwrap();
    let file = File::create(folder.join(format!("{}.tsv", std::process::id()))).unwrap();
    Some(Mutex::new((file, HashMap::new())))
});

/// Writes down what the running test measured, if it used more of its tolerance than before.
#[track_caller]
pub fn record(figure: f64, tolerance: f64, reason: &str) {
    let Some(measurements) = &*MEASUREMENTS else { return };
    let (file, most) = &mut *measurements.lock().unwrap();
    let (place, used) = (*Location::caller(), figure / tolerance);
    if most.get(&place).is_none_or(|before| used > *before) {
        most.insert(place, used);
        let test = std::thread::current();
        let (name, path, line) = (test.name().unwrap_or("main"), place.file(), place.line());
        file.write_all(
            format!("{path}: {name}\tline {line}\t{figure:e}\t{tolerance:e}\t{reason}\n").as_bytes(),
        )
        .unwrap();
    }
}

/// `figure ≤ tolerance`, written down; `because` says why more than a tenth of the tolerance may be used.
#[allow(unused_macros, reason = "no test binary needs everything")]
macro_rules! assert_within {
    ($figure:expr, $tolerance:expr, because $reason:literal $(, $($message:tt)+)?) => {{
        let (figure, tolerance): (f64, f64) = ($figure, $tolerance);
        $crate::common::measured::record(figure, tolerance, $reason);
        assert!(figure <= tolerance, "{figure:e}, allowed {tolerance:e} {}", String::new() $(+ &format!($($message)+))?);
    }};
    ($figure:expr, $tolerance:expr $(, $($message:tt)+)?) => {
        $crate::common::assert_within!($figure, $tolerance, because "" $(, $($message)+)?)
    };
}
pub(crate) use assert_within;
