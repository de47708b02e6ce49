//! Layout of the regressor's entries: which are structurally nonzero, and where each is written.

use crate::error::Error;
use crate::mechanism::{LINK_PARAMETERS, Mechanism};
use std::sync::{Arc, Mutex, PoisonError};

/// Index of an entry that is not requested, and so not computed.
const NOWHERE: usize = usize::MAX;

/// Output runs of the ten entries of one axis.
pub(crate) type LinkEntries = [usize; LINK_PARAMETERS];

/// Output run of every entry of one set of rows.
#[derive(Debug, Clone)]
pub(crate) struct EntryMap {
    /// Per axis of the mechanism: the runs, and a bit for each requested entry.
    pub(crate) axes: Vec<(LinkEntries, u32)>,
    /// Per term, and per coordinate that it acts on.
    terms: Vec<usize>,
}

impl EntryMap {
    /// `place(row, column)` gives the run of an entry that can differ from zero, `None` if it is not requested.
    pub(crate) fn new(mechanism: &Mechanism, mut place: impl FnMut(usize, usize) -> Option<usize>) -> EntryMap {
        let mut axes = Vec::with_capacity(mechanism.axes);
        for (i, link) in mechanism.links.iter().enumerate() {
            for axis in &link.axes {
                let mut requested = 0;
                let places = core::array::from_fn(|p| {
                    let place = place(axis.coordinate, LINK_PARAMETERS * i + p);
                    requested |= u32::from(place.is_some()) << p;
                    place.unwrap_or(NOWHERE)
                });
                axes.push((places, requested));
            }
        }
        let mut terms = Vec::new();
        for (c, term) in (mechanism.inertial_columns()..).zip(&mechanism.terms) {
            terms.extend(term.joint_map.rates.iter().map(|rate| place(rate.0, c).unwrap_or(NOWHERE)));
        }
        EntryMap { axes, terms }
    }

    /// The run of a term's entry; `rate` counts the rates of all terms.
    pub(crate) fn term(&self, rate: usize) -> Option<usize> {
        Some(self.terms[rate]).filter(|&place| place != NOWHERE)
    }
}

/// Which of the chosen columns can differ from zero in each row: coordinates x columns, row-major. All other entries of
/// the regressor are zero by structure: the link does not move with the coordinate, or the term does not act on it.
///
/// # Example
///
/// ```
/// # use haptid_core::*;
/// # const EYE: [f64; 9] = [1., 0., 0., 0., 1., 0., 0., 0., 1.];
/// # let bar = |parent, x| Joint { parent, rotation: EYE, translation: [x, 0., 0.], prismatic: false };
/// # let arm = Mechanism::new(&[bar(None, 0.), bar(Some(0), 1.)], &Closure::open(2), [0.; 3], &[], Backend::best())?;
/// // ZZ of both links of an arm: the first link does not move with the second joint.
/// assert_eq!(structural_nonzeros(&arm, &[5, 15])?, [true, true, false, true]);
/// # Ok::<(), haptid_core::Error>(())
/// ```
pub fn structural_nonzeros(mechanism: &Mechanism, columns: &[usize]) -> Result<Vec<bool>, Error> {
    check_columns(mechanism, columns)?;
    let na = mechanism.coordinates;
    Ok((0..na).flat_map(|a| columns.iter().map(move |&c| mechanism.is_structural_nonzero(a, c))).collect())
}

pub(crate) fn check_columns(mechanism: &Mechanism, columns: &[usize]) -> Result<(), Error> {
    let mut taken = vec![false; mechanism.columns()];
    for &got in columns {
        match taken.get_mut(got) {
            None => return Err(Error::Index { name: "column", got, limit: mechanism.columns() }),
            Some(true) => return Err(Error::Repeated { name: "column", got }),
            Some(free) => *free = true,
        }
    }
    Ok(())
}

/// Layout of the chosen columns of all rows. Entry numbers are row * chosen + column, set after set.
#[derive(Debug)]
pub(crate) struct ColumnLayout {
    columns: Vec<usize>,
    /// Number of entries.
    pub(crate) entries: usize,
    /// Entries that can differ from zero, in packed order, and those that cannot.
    pub(crate) nonzero: Vec<usize>,
    pub(crate) zero: Vec<usize>,
    /// Every entry in the run of its own number.
    pub(crate) in_place: Vec<EntryMap>,
    /// Nonzero entries only, one run after the other.
    pub(crate) packed: Vec<EntryMap>,
}

impl ColumnLayout {
    fn new(mechanism: &Mechanism, sets: usize, columns: &[usize]) -> ColumnLayout {
        let (na, p) = (mechanism.coordinates, columns.len());
        let mut chosen = vec![None; mechanism.columns()];
        columns.iter().enumerate().for_each(|(c, &column)| chosen[column] = Some(c));
        let entry = |set: usize, a: usize, column: usize| {
            // Of two sets the first holds the momenta.
            let there = set + 1 == sets || mechanism.has_momentum(column);
            chosen[column].filter(|_| there).map(|c| (set * na + a) * p + c)
        };
        let in_place = (0..sets).map(|set| EntryMap::new(mechanism, |a, column| entry(set, a, column))).collect();
        let mut nonzero = Vec::new();
        let mut packed = |set: usize, a: usize, column: usize| {
            nonzero.push(entry(set, a, column)?);
            Some(nonzero.len() - 1)
        };
        let packed = (0..sets).map(|set| EntryMap::new(mechanism, |a, column| packed(set, a, column))).collect();
        let all = sets * na * p;
        let mut zero = vec![true; all];
        nonzero.iter().for_each(|&entry| zero[entry] = false);
        let zero = (0..all).filter(|&entry| zero[entry]).collect();
        ColumnLayout { columns: columns.to_vec(), entries: all, nonzero, zero, in_place, packed }
    }
}

/// The layout that was used last: a caller usually evaluates the same columns again. A cloned mechanism starts without
/// one.
#[derive(Debug, Default)]
pub(crate) struct LayoutCache(Mutex<Option<Arc<ColumnLayout>>>);

impl Clone for LayoutCache {
    fn clone(&self) -> LayoutCache {
        LayoutCache::default()
    }
}

impl Mechanism {
    /// The layout of these columns, with one set of rows or two.
    pub(crate) fn column_layout(&self, sets: usize, columns: &[usize]) -> Result<Arc<ColumnLayout>, Error> {
        let mut last = self.layout_cache.0.lock().unwrap_or_else(PoisonError::into_inner);
        match last.as_ref().filter(|layout| layout.columns == columns && layout.packed.len() == sets) {
            Some(layout) => Ok(layout.clone()),
            None => {
                check_columns(self, columns)?;
                Ok(last.insert(Arc::new(ColumnLayout::new(self, sets, columns))).clone())
            }
        }
    }
}
