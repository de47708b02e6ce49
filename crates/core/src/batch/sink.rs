//! Where the entries of the rows go, and which are wanted at all.

use crate::mechanism::LINK_PARAMETERS;
use crate::mechanism::layout::{EntryMap, LinkEntries};
use crate::simd::lane::Lane;

/// EntryRuns of numbers, equally far apart: an entry's run by its number.
#[derive(Clone, Copy)]
pub(crate) struct EntryRuns {
    pub(crate) first: *mut f64,
    pub(crate) apart: usize,
}

impl EntryRuns {
    /// Where run number `place` begins; nowhere for no place.
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

/// Takes the entries of one link and axis that somebody wants.
#[derive(Clone, Copy)]
pub(crate) struct EntrySink<'a> {
    places: &'a LinkEntries,
    /// One bit for each parameter.
    pub(crate) wanted: u32,
    out: EntryRuns,
}

impl EntrySink<'_> {
    /// The same with a set that is a constant: that of the sink, or [`ANY`].
    #[inline(always)]
    pub(crate) fn of<const SET: u32>(&self) -> ConstSink<SET> {
        ConstSink { places: self.places.map(|place| self.out.at(place)), wanted: self.wanted }
    }
}

/// Takes the entries of a set that the compiler knows: what is not in it is not computed.
pub(crate) struct ConstSink<const SET: u32> {
    places: [*mut f64; LINK_PARAMETERS],
    wanted: u32,
}

impl<const SET: u32> ConstSink<SET> {
    /// # Safety
    /// The entry's place has room for a lane from number `k` on.
    #[inline(always)]
    pub(crate) unsafe fn put<T: Lane>(&self, p: usize, k: usize, entry: T) {
        let wanted = if SET == ANY { self.wanted } else { SET };
        if wanted & 1 << p != 0 {
            unsafe { entry.store(self.places[p].add(k)) };
        }
    }
}

/// Any set of entries: each is asked for.
pub(crate) const ANY: u32 = 0;

/// Evaluate an expression with the sink's set as a constant, if it is a common one: all entries; the base parameters of
/// most turning links; those of a link that turns about a fixed direction; those of a link whose tensor is part of
/// another's.
macro_rules! for_set {
    ($sink:expr, $set:ident => $body:expr) => {
        $crate::batch::sink::for_set!($sink, [0b11_1111_1111, 0b00_1111_0111, 0b00_1110_0000, 0b00_1100_0000], $set => $body)
    };
    ($sink:expr, [$($common:literal),*], $set:ident => $body:expr) => {
        match $sink.wanted {
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
    /// EntryMap of an axis's entries.
    pub(crate) fn axis(&self, axis: usize, out: EntryRuns) -> EntrySink<'_> {
        let (places, wanted) = &self.axes[axis];
        EntrySink { places, wanted: *wanted, out }
    }
}
