//! An output array that several threads fill.

/// Pointer to an output array of which each thread writes its own numbers. Only `unsafe` methods give access to them.
#[derive(Clone, Copy)]
pub(crate) struct SharedOutput(*mut f64);

// SAFETY: the pointer is dereferenced only under the promise of [`SharedOutput::at`]'s callers: no number is written by
// two threads.
unsafe impl Send for SharedOutput {}
// SAFETY: as for `Send`.
unsafe impl Sync for SharedOutput {}

impl SharedOutput {
    pub(crate) fn new(numbers: &mut [f64]) -> SharedOutput {
        SharedOutput(numbers.as_mut_ptr())
    }

    /// # Safety
    ///
    /// `number` is at most the length of the array. What is written there belongs to the calling thread alone, while
    /// the array is borrowed.
    pub(crate) unsafe fn at(self, number: usize) -> *mut f64 {
        // SAFETY: the caller's promise keeps the pointer inside the array, or one past it.
        unsafe { self.0.add(number) }
    }
}
