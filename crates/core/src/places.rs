//! Where the entries of the rows go, and which are wanted at all.

use crate::lane::Lane;
use crate::mechanism::{LINK_PARAMETERS, Mechanism};

/// No place: an entry that nobody wants is not computed.
const NOWHERE: usize = usize::MAX;

/// Places of the ten entries of one axis, from `out` on.
pub(crate) type LinkPlaces = [usize; LINK_PARAMETERS];

/// One set of rows: entry by entry the number in `out` where its first sample goes.
#[derive(Debug, Clone)]
pub(crate) struct Places {
    /// By axis of the mechanism.
    axes: Vec<LinkPlaces>,
    /// By term, and by the coordinates that move it.
    terms: Vec<usize>,
}

impl Places {
    /// Ask `place` for every entry that can differ from zero, by row and column; it answers with the entry's first
    /// number, if the entry is wanted.
    pub(crate) fn new(mechanism: &Mechanism, mut place: impl FnMut(usize, usize) -> Option<usize>) -> Places {
        let mut at = |row, column| place(row, column).unwrap_or(NOWHERE);
        let mut axes = Vec::with_capacity(mechanism.axes);
        for (i, link) in mechanism.links.iter().enumerate() {
            for axis in &link.axes {
                axes.push(core::array::from_fn(|p| at(axis.coordinate, LINK_PARAMETERS * i + p)));
            }
        }
        let mut terms = Vec::new();
        for (c, term) in (mechanism.inertial_columns()..).zip(&mechanism.terms) {
            terms.extend(term.course.rates.iter().map(|rate| at(rate.0, c)));
        }
        Places { axes, terms }
    }

    /// Places of an axis's entries.
    pub(crate) fn axis(&self, axis: usize) -> Sink<'_> {
        let places = &self.axes[axis];
        let wanted = (0..LINK_PARAMETERS).filter(|&p| places[p] != NOWHERE).fold(0, |mask, p| mask | 1 << p);
        Sink { places, wanted }
    }

    /// The place of a term's entry, by the number of its rate among all terms'.
    pub(crate) fn term(&self, rate: usize) -> Option<usize> {
        Some(self.terms[rate]).filter(|&place| place != NOWHERE)
    }
}

/// Takes the entries of one link and axis that somebody wants.
#[derive(Clone, Copy)]
pub(crate) struct Sink<'a> {
    places: &'a LinkPlaces,
    /// One bit for each parameter.
    wanted: u32,
}

/// Bits of the six entries of the inertia tensor, the three of the first moment, and that of the mass.
pub(crate) const TENSOR: u32 = 0b00_0011_1111;
pub(crate) const MOMENT: u32 = 0b01_1100_0000;
pub(crate) const MASS: u32 = 0b10_0000_0000;

impl Sink<'_> {
    /// Whether any of these entries is wanted.
    #[inline(always)]
    pub(crate) fn wants(&self, bits: u32) -> bool {
        self.wanted & bits != 0
    }

    /// Write entries `first..first + N` as far as they are wanted.
    ///
    /// # Safety
    /// Their places have room for a lane from number `k` on.
    #[inline(always)]
    pub(crate) unsafe fn put<T: Lane, const N: usize>(&self, out: *mut f64, k: usize, first: usize, entries: [T; N]) {
        for (p, entry) in (first..).zip(entries) {
            if self.wants(1 << p) {
                unsafe { entry.store(out.add(self.places[p] + k)) };
            }
        }
    }
}
