//! [`flight_sim`] for a web page: flights that advance tick by tick.
//!
//! WebAssembly functions take and return only numbers. Text and files go through [`reserve`], requests and answers are
//! JSON ([`ask`], [`answer`]), and signals are read in place ([`series`], [`pose`]). A pointer is valid until the next
//! call. `rust/lab/page/lab.js` is the counterpart.

mod flights;

use flights::Flights;
use std::cell::RefCell;
use std::path::Path;

thread_local! {
    static FLIGHTS: RefCell<Flights> = RefCell::default();
    static INPUT: RefCell<Vec<u8>> = RefCell::default();
    static ANSWER: RefCell<String> = RefCell::default();
}

/// Returns the address at which to write `length` bytes of input.
#[unsafe(no_mangle)]
pub extern "C" fn reserve(length: usize) -> *mut u8 {
    INPUT.with_borrow_mut(|input| {
        input.clear();
        input.resize(length, 0);
        input.as_mut_ptr()
    })
}

/// Holds a file in memory: the input is its path, of `path_length` bytes, then its content.
#[unsafe(no_mangle)]
pub extern "C" fn hold(path_length: usize) {
    INPUT.with_borrow(|input| {
        let (path, content) = input.split_at(path_length.min(input.len()));
        flight_io::hold(Path::new(&*String::from_utf8_lossy(path)), content.to_vec());
    });
}

/// Processes the input as a request and returns the length of its answer.
#[unsafe(no_mangle)]
pub extern "C" fn ask() -> usize {
    let said = INPUT.with_borrow(|input| FLIGHTS.with_borrow_mut(|flights| flights.answer(input)));
    let length = said.len();
    ANSWER.set(said);
    length
}

/// Returns the address of the last answer.
#[unsafe(no_mangle)]
pub extern "C" fn answer() -> *const u8 {
    ANSWER.with_borrow(|answer| answer.as_ptr())
}

/// Flies up to `ticks` ticks and returns the number of rows in the log. No effect on a flight that has ended.
#[unsafe(no_mangle)]
pub extern "C" fn advance(flight: usize, ticks: usize) -> usize {
    FLIGHTS.with_borrow_mut(|flights| flights.advance(flight, ticks))
}

/// Returns the address of the rows of a signal, which are contiguous; null if there is no such signal.
#[unsafe(no_mangle)]
pub extern "C" fn series(flight: usize, index: usize) -> *const f64 {
    FLIGHTS.with_borrow(|flights| flights.series(flight, index).map_or(std::ptr::null(), <[f64]>::as_ptr))
}

/// Returns the address of the poses of all bodies at a row of the log: rotation by columns, then position, inertial
/// axes; null if there is no such row.
#[unsafe(no_mangle)]
pub extern "C" fn pose(flight: usize, row: usize) -> *const f64 {
    FLIGHTS.with_borrow_mut(|flights| flights.pose(flight, row).map_or(std::ptr::null(), <[f64]>::as_ptr))
}
