//! The updates of the benchmarks as a library that other programs call: `compare.py` times them beside JAX and PyTorch in
//! one process, and as wasm beside native code.
//!
//! The unsafe attributes are sound: no other symbol of this library has these names.
#![allow(unsafe_code)]

mod cases;

use cases::{CASES, Update, update};
use std::cell::RefCell;

thread_local!(static UPDATE: RefCell<Option<Update>> = const { RefCell::new(None) });

/// Character number `position` of the name of case number `case`; zero behind the last one and beyond the last case.
#[unsafe(no_mangle)]
pub extern "C" fn letter(case: u32, position: u32) -> u32 {
    let name = CASES.get(case as usize).map_or("", |(name, _)| name);
    name.as_bytes().get(position as usize).map_or(0, |&byte| u32::from(byte))
}

/// Sets up a case, from the same beginning each time.
#[unsafe(no_mangle)]
pub extern "C" fn prepare(case: u32) {
    let (_, once) = update(CASES[case as usize].1);
    UPDATE.with(|update| *update.borrow_mut() = Some(once));
}

/// Makes updates and returns a digest of their losses, an integer below 2³².
#[unsafe(no_mangle)]
pub extern "C" fn run(count: u32) -> f64 {
    UPDATE.with(|update| {
        let mut update = update.borrow_mut();
        let update = update.as_mut().expect("a case is prepared");
        let digest = (0..count).fold(0, |digest: u32, _| digest.rotate_left(5) ^ update().to_bits());
        f64::from(digest)
    })
}
