//! Sinks: where the kernels write the entries of the rows, of which they compute only the requested ones.

use crate::mechanism::LINK_PARAMETERS;
use crate::mechanism::layout::{EntryMap, LinkEntries};
use crate::simd::inlined;
use crate::simd::lane::Lane;

/// Output runs at a constant distance, one for each entry.
#[derive(Clone, Copy)]
pub(crate) struct EntryRuns {
    pub(crate) first: *mut f64,
    pub(crate) apart: usize,
}

impl EntryRuns {
    /// Beginning of an entry's run; dangling for an entry that is not requested, and then never dereferenced.
    #[inline(always)]
    pub(crate) fn at(self, place: usize) -> *mut f64 {
        self.first.wrapping_add(place.wrapping_mul(self.apart))
    }

    /// The same runs from their number `k` on.
    #[inline(always)]
    pub(crate) fn from(self, k: usize) -> EntryRuns {
        EntryRuns { first: self.first.wrapping_add(k), apart: self.apart }
    }
}

/// Output of the entries of one link and axis.
#[derive(Clone, Copy)]
pub(crate) struct EntrySink<'a> {
    places: &'a LinkEntries,
    /// One bit for each requested parameter.
    pub(crate) requested: u32,
    out: EntryRuns,
}

impl EntrySink<'_> {
    /// The same sink with the set of requested entries as a compile-time constant: its own set, or [`ANY`].
    #[inline(always)]
    pub(crate) fn of<const SET: u32>(&self) -> ConstSink<SET> {
        ConstSink { places: inlined::map(*self.places, |place| self.out.at(place)), requested: self.requested }
    }
}

/// A sink whose set the compiler knows: entries outside the set are not computed.
pub(crate) struct ConstSink<const SET: u32> {
    places: [*mut f64; LINK_PARAMETERS],
    requested: u32,
}

impl<const SET: u32> ConstSink<SET> {
    /// Store an entry, if it is requested.
    ///
    /// # Safety
    ///
    /// The entry's run has room for a lane from number `k` on.
    #[inline(always)]
    pub(crate) unsafe fn put<T: Lane>(&self, p: usize, k: usize, entry: T) {
        let requested = if SET == ANY { self.requested } else { SET };
        if requested & 1 << p != 0 {
            // SAFETY: the entry is requested, so that its place is a run, in which the caller promises room.
            unsafe { entry.store(self.places[p].add(k)) };
        }
    }
}

/// Set that is known at run time only.
pub(crate) const ANY: u32 = 0;

/// Evaluate an expression with the sink's set as a compile-time constant, if it is a common one: all entries; base
/// parameters of most revolute links; those of a link that turns about a fixed direction; those of a link whose tensor
/// is regrouped with another's.
macro_rules! for_set {
    ($sink:expr, $set:ident => $body:expr) => {
        $crate::batch::sink::for_set!($sink, [0b11_1111_1111, 0b00_1111_0111, 0b00_1110_0000, 0b00_1100_0000], $set => $body)
    };
    ($sink:expr, [$($common:literal),*], $set:ident => $body:expr) => {
        match $sink.requested {
            $($common => {
                const $set: u32 = $common;
                $body
            })*
            _ => {
                const $set: u32 = $crate::batch::sink::ANY;
                $body
            }
        }
    };
}
pub(crate) use for_set;

impl EntryMap {
    /// Sink for the entries of an axis.
    pub(crate) fn axis(&self, axis: usize, out: EntryRuns) -> EntrySink<'_> {
        let (places, requested) = &self.axes[axis];
        EntrySink { places, requested: *requested, out }
    }
}
