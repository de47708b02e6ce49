//! An output array that several threads fill.

/// An array that threads write to, each its own numbers.
#[derive(Clone, Copy)]
pub(crate) struct SharedOutput(*mut f64);

// SAFETY: whoever writes promises that nobody else writes the same numbers.
unsafe impl Send for SharedOutput {}
unsafe impl Sync for SharedOutput {}

impl SharedOutput {
    pub(crate) fn new(numbers: &mut [f64]) -> SharedOutput {
        SharedOutput(numbers.as_mut_ptr())
    }

    /// # Safety
    /// `number` is inside the array, or one past it.
    pub(crate) unsafe fn at(self, number: usize) -> *mut f64 {
        unsafe { self.0.add(number) }
    }
}
