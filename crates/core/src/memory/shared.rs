//! An output array that several threads fill.

use core::marker::PhantomData;
use core::mem::MaybeUninit;

/// Pointer to an output array of which each thread writes its own numbers, while the array is borrowed. Only `unsafe`
/// methods give access to them.
#[derive(Clone, Copy)]
pub(crate) struct SharedOutput<'a>(*mut f64, PhantomData<&'a mut [f64]>);

// SAFETY: the pointer is dereferenced only under the promise of [`SharedOutput::at`]'s callers: no number is written by
// two threads.
unsafe impl Send for SharedOutput<'_> {}
// SAFETY: as for `Send`.
unsafe impl Sync for SharedOutput<'_> {}

impl<'a> SharedOutput<'a> {
    pub(crate) fn new(numbers: &'a mut [f64]) -> SharedOutput<'a> {
        SharedOutput(numbers.as_mut_ptr(), PhantomData)
    }

    /// Of numbers that need not be initialised: they are written only, and none is read before.
    pub(crate) fn new_uninitialised(numbers: &'a mut [MaybeUninit<f64>]) -> SharedOutput<'a> {
        SharedOutput(numbers.as_mut_ptr().cast(), PhantomData)
    }

    /// # Safety
    ///
    /// `number` is at most the length of the array. What is written there belongs to the calling thread alone.
    pub(crate) unsafe fn at(self, number: usize) -> *mut f64 {
        // SAFETY: the caller's promise keeps the pointer inside the array, or one past it.
        unsafe { self.0.add(number) }
    }
}
