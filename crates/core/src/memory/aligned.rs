//! Buffers aligned to cache lines: a load or store that crosses two lines takes two accesses.

use crate::simd::lane::MAX_WIDTH;
use std::ops::{Deref, DerefMut};

/// One cache line: as many numbers as the widest lane has.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
struct Line([f64; MAX_WIDTH]);

/// Numbers in whole cache lines.
#[derive(Clone, Default)]
pub(crate) struct Aligned(Vec<Line>);

impl Aligned {
    /// Resize to this many zeros, rounded up to a whole line; allocated memory is reused.
    pub(crate) fn clear(&mut self, numbers: usize) {
        self.0.clear();
        self.grow(numbers);
    }

    /// Resize to this many numbers, rounded up to a whole line; the present ones are kept, and new ones are zero.
    pub(crate) fn resize(&mut self, numbers: usize) {
        self.0.resize(numbers.div_ceil(MAX_WIDTH), Line([0.0; MAX_WIDTH]));
    }

    /// Extend to at least this many numbers; the present ones are kept.
    pub(crate) fn grow(&mut self, numbers: usize) {
        let lines = numbers.div_ceil(MAX_WIDTH);
        if self.0.len() < lines {
            self.0.resize(lines, Line([0.0; MAX_WIDTH]));
        }
    }
}

impl Deref for Aligned {
    type Target = [f64];

    fn deref(&self) -> &[f64] {
        // SAFETY: `Line` is `repr(C)` around `[f64; MAX_WIDTH]` without padding, so that the lines are one array of
        // f64.
        unsafe { core::slice::from_raw_parts(self.0.as_ptr().cast(), self.0.len() * MAX_WIDTH) }
    }
}

impl DerefMut for Aligned {
    fn deref_mut(&mut self) -> &mut [f64] {
        // SAFETY: as in `deref`; the borrow of `self` is unique.
        unsafe { core::slice::from_raw_parts_mut(self.0.as_mut_ptr().cast(), self.0.len() * MAX_WIDTH) }
    }
}
