//! What the documentation shows as a program, runs and prints what the documentation says.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use std::cell::RefCell;

thread_local! {
    static PRINTED: RefCell<Vec<String>> = const { RefCell::new(Vec::new()) };
}

/// In place of the standard one for the program below.
macro_rules! println {
    ($($what:tt)*) => { super::PRINTED.with_borrow_mut(|lines| lines.push(format!($($what)*))) };
}

#[path = "../examples/tutorial.rs"]
mod tutorial;

#[test]
fn the_tutorial_prints_what_its_page_shows() {
    tutorial::main().unwrap();
    let page = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/tutorial.md");
    let page = std::fs::read_to_string(page).unwrap();
    let (_, shown) = page.split_once("```text\n").unwrap();
    let (shown, _) = shown.split_once("```").unwrap();
    let printed = PRINTED.with_borrow(|lines| lines.join("\n"));
    assert_eq!(printed, shown.trim_end());
}
