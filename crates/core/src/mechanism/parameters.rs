//! Parameters of all columns: one set for all samples, or several sets.

use crate::error::{Error, expect_length};
use crate::mechanism::{LINK_PARAMETERS, Mechanism};
use crate::memory::slot::{BATCH, Slot, grow, load};
use crate::simd::lane::{Lane, MAX_WIDTH};
use crate::simd::token::Simd;

/// Sets of parameters, one after another. The samples are divided among them evenly, in order.
pub(crate) struct ParameterSets<'a> {
    chi: &'a [f64],
    columns: usize,
    /// Samples per set.
    per: usize,
    /// Links with a nonzero parameter in any set, and terms.
    has_mass: Vec<bool>,
    used: Vec<bool>,
}

impl<'a> ParameterSets<'a> {
    pub(crate) fn new(mechanism: &Mechanism, samples: usize, chi: &'a [f64]) -> Result<ParameterSets<'a>, Error> {
        let (columns, links) = (mechanism.columns(), mechanism.links.len());
        let count = chi.len().checked_div(columns).unwrap_or(1).max(1);
        expect_length("chi", chi.len(), count * columns)?;
        let per = samples / count;
        expect_length("samples of equally large sets", samples, per * count)?;
        let mut sets = ParameterSets { chi, columns, per, has_mass: vec![false; links], used: vec![false; columns] };
        for set in chi.chunks_exact(columns.max(1)) {
            sets.used.iter_mut().zip(set).for_each(|(wanted, &x)| *wanted |= x != 0.0);
        }
        let terms = sets.used.split_off(LINK_PARAMETERS * links);
        for (has_mass, link) in sets.has_mass.iter_mut().zip(sets.used.chunks_exact(LINK_PARAMETERS)) {
            *has_mass = link.contains(&true);
        }
        sets.used = terms;
        Ok(sets)
    }

    /// Whether a link has a nonzero parameter.
    pub(crate) fn has_mass(&self, link: usize) -> bool {
        self.has_mass[link]
    }

    /// Whether a term has a nonzero parameter.
    pub(crate) fn is_used(&self, term: usize) -> bool {
        self.used[term]
    }
}

/// The parameters at a batch of samples. Where all samples share one set, only the first lane of each slot is valid.
#[derive(Default)]
pub(crate) struct ParameterSlots {
    slots: Vec<Slot>,
    /// The set of all samples of the batch, if there is only one.
    set: Option<usize>,
}

impl ParameterSlots {
    pub(crate) fn grow(&mut self, mechanism: &Mechanism) {
        grow(&mut self.slots, mechanism.columns(), Slot::ZERO);
    }

    /// Invalidate what an earlier motion has left.
    pub(crate) fn clear(&mut self) {
        self.set = None;
    }

    /// Load the parameters of samples `from..from + count`, at most a batch.
    pub(crate) fn advance_to(&mut self, sets: &ParameterSets, from: usize, count: usize) {
        let set = from / sets.per;
        if (from + count - 1) / sets.per != set {
            self.set = None;
            for (column, slot) in self.slots[..sets.columns].iter_mut().enumerate() {
                for (k, x) in slot.0.iter_mut().enumerate() {
                    let set = (from + k.min(count - 1)) / sets.per;
                    *x = sets.chi[set * sets.columns + column];
                }
            }
        } else if self.set != Some(set) {
            self.set = Some(set);
            let chi = &sets.chi[set * sets.columns..][..sets.columns];
            self.slots.iter_mut().zip(chi).for_each(|(slot, &x)| slot.0[..MAX_WIDTH].fill(x));
        }
    }

    /// First sample of the lane of parameters that belongs to samples from `k` on.
    #[inline(always)]
    fn at(&self, k: usize) -> usize {
        debug_assert!(k < BATCH);
        if self.set.is_some() { 0 } else { k }
    }

    /// The ten parameters of a link.
    ///
    /// # Safety
    ///
    /// `k + T::WIDTH <= BATCH`.
    #[inline(always)]
    pub(crate) unsafe fn link<T: Lane>(&self, simd: Simd<T>, link: usize, k: usize) -> [T; LINK_PARAMETERS] {
        let slots = &self.slots[LINK_PARAMETERS * link..][..LINK_PARAMETERS];
        // SAFETY: `at` is 0 or k; both leave room for a lane in the slots of the link.
        unsafe { load(simd, slots.as_ptr(), self.at(k)) }
    }

    /// The parameter of a column.
    ///
    /// # Safety
    ///
    /// As for [`ParameterSlots::link`].
    #[inline(always)]
    pub(crate) unsafe fn column<T: Lane>(&self, simd: Simd<T>, column: usize, k: usize) -> T {
        // SAFETY: as in `link`.
        let [x] = unsafe { load(simd, &self.slots[column], self.at(k)) };
        x
    }
}
