//! Parameters of all columns, in one set for all samples or in several.

use crate::error::{Error, expect_length};
use crate::mechanism::{LINK_PARAMETERS, Mechanism};
use crate::memory::slot::grow;
use crate::memory::slot::{BATCH, Slot, load};
use crate::simd::lane::{Lane, MAX_WIDTH};

/// ParameterSets of parameters, one after another; the samples are shared out among them evenly, in order.
pub(crate) struct ParameterSets<'a> {
    chi: &'a [f64],
    columns: usize,
    /// Samples of a set.
    per: usize,
    /// Links and terms of which a parameter is not zero in every set.
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

    /// Whether a link's bodies have any parameters.
    pub(crate) fn has_mass(&self, link: usize) -> bool {
        self.has_mass[link]
    }

    /// Whether a term has a parameter.
    pub(crate) fn is_used(&self, term: usize) -> bool {
        self.used[term]
    }
}

/// The parameters of a batch of samples. Where all have the same, only a lane of each is there.
#[derive(Default)]
pub(crate) struct ParameterSlots {
    slots: Vec<Slot>,
    /// The set of all the batch's samples, if it is one.
    set: Option<usize>,
}

impl ParameterSlots {
    pub(crate) fn grow(&mut self, mechanism: &Mechanism) {
        grow(&mut self.slots, mechanism.columns(), Slot::ZERO);
    }

    /// Forget what an earlier motion left.
    pub(crate) fn clear(&mut self) {
        self.set = None;
    }

    /// The parameters of samples `from..from + count`, at most a batch of them.
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

    /// Where a lane of parameters begins, for samples from `k` on.
    #[inline(always)]
    fn at(&self, k: usize) -> usize {
        debug_assert!(k < BATCH);
        if self.set.is_some() { 0 } else { k }
    }

    /// The ten parameters of a link.
    ///
    /// # Safety
    /// A lane from `k` on is inside the batch.
    #[inline(always)]
    pub(crate) unsafe fn link<T: Lane>(&self, link: usize, k: usize) -> [T; LINK_PARAMETERS] {
        let slots = &self.slots[LINK_PARAMETERS * link..][..LINK_PARAMETERS];
        unsafe { load(slots.as_ptr(), self.at(k)) }
    }

    /// The parameter of a column.
    ///
    /// # Safety
    /// As for [`ParameterSlots::link`].
    #[inline(always)]
    pub(crate) unsafe fn column<T: Lane>(&self, column: usize, k: usize) -> T {
        let [x] = unsafe { load(&self.slots[column], self.at(k)) };
        x
    }
}
