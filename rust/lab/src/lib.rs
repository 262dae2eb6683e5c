//! [`flight_sim`] for a page in a browser: flights that are flown tick by tick.
//!
//! WebAssembly functions take and return numbers alone. Text and files go through [`reserve`], questions and answers are
//! JSON ([`ask`], [`answer`]), and signals are read where they lie ([`series`], [`pose`]). A pointer holds until the next
//! call. `rust/lab/page/lab.js` is the other side.

mod flights;

use flights::Flights;
use std::cell::RefCell;
use std::path::Path;

thread_local! {
    static FLIGHTS: RefCell<Flights> = RefCell::default();
    static INPUT: RefCell<Vec<u8>> = RefCell::default();
    static ANSWER: RefCell<String> = RefCell::default();
}

/// Where to write `length` bytes of input.
#[unsafe(no_mangle)]
pub extern "C" fn reserve(length: usize) -> *mut u8 {
    INPUT.with_borrow_mut(|input| {
        input.clear();
        input.resize(length, 0);
        input.as_mut_ptr()
    })
}

/// Holds a file: the input is its path, `path_length` bytes of it, then its content.
#[unsafe(no_mangle)]
pub extern "C" fn hold(path_length: usize) {
    INPUT.with_borrow(|input| {
        let (path, content) = input.split_at(path_length.min(input.len()));
        flight_io::hold(Path::new(&*String::from_utf8_lossy(path)), content.to_vec());
    });
}

/// Takes the input as a question and returns the length of its answer.
#[unsafe(no_mangle)]
pub extern "C" fn ask() -> usize {
    let said = INPUT.with_borrow(|input| FLIGHTS.with_borrow_mut(|flights| flights.answer(input)));
    let length = said.len();
    ANSWER.set(said);
    length
}

/// Where the last answer lies.
#[unsafe(no_mangle)]
pub extern "C" fn answer() -> *const u8 {
    ANSWER.with_borrow(|answer| answer.as_ptr())
}

/// Flies up to `ticks` ticks; the number of rows in the log. A flight that has ended stays as it is.
#[unsafe(no_mangle)]
pub extern "C" fn advance(flight: usize, ticks: usize) -> usize {
    FLIGHTS.with_borrow_mut(|flights| flights.advance(flight, ticks))
}

/// Where the rows of a signal lie, one after the other; null if there is no such signal.
#[unsafe(no_mangle)]
pub extern "C" fn series(flight: usize, index: usize) -> *const f64 {
    FLIGHTS.with_borrow(|flights| flights.series(flight, index).map_or(std::ptr::null(), <[f64]>::as_ptr))
}

/// Where the poses of all bodies at a row of the log lie: rotation by columns, then position, inertial axes; null if there
/// is no such row.
#[unsafe(no_mangle)]
pub extern "C" fn pose(flight: usize, row: usize) -> *const f64 {
    FLIGHTS.with_borrow_mut(|flights| flights.pose(flight, row).map_or(std::ptr::null(), <[f64]>::as_ptr))
}
