//! Buffers aligned to the lines of the caches: a lane that crosses two lines takes two accesses.

use crate::simd::lane::MAX_WIDTH;
use std::ops::{Deref, DerefMut};

/// One line: the numbers of the widest lane.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
struct Line([f64; MAX_WIDTH]);

/// Whole lines of numbers.
#[derive(Default)]
pub(crate) struct Aligned(Vec<Line>);

impl Aligned {
    /// Hold so many zeros, up to a whole line, in the memory that is there as far as it reaches.
    pub(crate) fn clear(&mut self, numbers: usize) {
        self.0.clear();
        self.grow(numbers);
    }

    /// Make room for so many numbers; those that are there stay.
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
        // SAFETY: a line is nothing but its numbers.
        unsafe { core::slice::from_raw_parts(self.0.as_ptr().cast(), self.0.len() * MAX_WIDTH) }
    }
}

impl DerefMut for Aligned {
    fn deref_mut(&mut self) -> &mut [f64] {
        // SAFETY: as above.
        unsafe { core::slice::from_raw_parts_mut(self.0.as_mut_ptr().cast(), self.0.len() * MAX_WIDTH) }
    }
}
