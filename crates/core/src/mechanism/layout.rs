//! Where the entries of a regressor go, found once for the columns that are asked for again and again.

use crate::error::Error;
use crate::mechanism::{LINK_PARAMETERS, Mechanism};
use std::sync::{Arc, Mutex, PoisonError};

/// No place: an entry that nobody wants is not computed.
const NOWHERE: usize = usize::MAX;

/// EntryRuns of the ten entries of one axis.
pub(crate) type LinkEntries = [usize; LINK_PARAMETERS];

/// One set of rows: entry by entry the run where its samples go.
#[derive(Debug, Clone)]
pub(crate) struct EntryMap {
    /// By axis of the mechanism; with one bit for each entry that is wanted.
    pub(crate) axes: Vec<(LinkEntries, u32)>,
    /// By term, and by the coordinates that move it.
    terms: Vec<usize>,
}

impl EntryMap {
    /// Ask `place` for every entry that can differ from zero, by row and column; it answers with the entry's run,
    /// if the entry is wanted.
    pub(crate) fn new(mechanism: &Mechanism, mut place: impl FnMut(usize, usize) -> Option<usize>) -> EntryMap {
        let mut axes = Vec::with_capacity(mechanism.axes);
        for (i, link) in mechanism.links.iter().enumerate() {
            for axis in &link.axes {
                let mut wanted = 0;
                let places = core::array::from_fn(|p| {
                    let place = place(axis.coordinate, LINK_PARAMETERS * i + p);
                    wanted |= u32::from(place.is_some()) << p;
                    place.unwrap_or(NOWHERE)
                });
                axes.push((places, wanted));
            }
        }
        let mut terms = Vec::new();
        for (c, term) in (mechanism.inertial_columns()..).zip(&mechanism.terms) {
            terms.extend(term.joint_map.rates.iter().map(|rate| place(rate.0, c).unwrap_or(NOWHERE)));
        }
        EntryMap { axes, terms }
    }

    /// The place of a term's entry, by the number of its rate among all terms'.
    pub(crate) fn term(&self, rate: usize) -> Option<usize> {
        Some(self.terms[rate]).filter(|&place| place != NOWHERE)
    }
}

/// Which of the chosen columns each row can structural_nonzeros: coordinates x columns, row-major. The rest is structurally zero.
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

/// The entries of all rows and chosen columns, by number: row * chosen + column, set after set.
#[derive(Debug)]
pub(crate) struct ColumnLayout {
    columns: Vec<usize>,
    /// Number of entries.
    pub(crate) entries: usize,
    /// Entries that can differ from zero, in the order in which they are packed; and those that cannot.
    pub(crate) nonzero: Vec<usize>,
    pub(crate) zero: Vec<usize>,
    /// Every entry in the run of its own number.
    pub(crate) in_place: Vec<EntryMap>,
    /// Filled entries, one run after the other.
    pub(crate) packed: Vec<EntryMap>,
}

impl ColumnLayout {
    fn new(mechanism: &Mechanism, sets: usize, columns: &[usize]) -> ColumnLayout {
        let (na, p) = (mechanism.coordinates, columns.len());
        let mut chosen = vec![None; mechanism.columns()];
        columns.iter().enumerate().for_each(|(c, &column)| chosen[column] = Some(c));
        let entry = |set: usize, a: usize, column: usize| {
            // With two sets the first one holds the momenta.
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

/// The plan that was asked for last; a mechanism that is cloned begins without one.
#[derive(Debug, Default)]
pub(crate) struct LayoutCache(Mutex<Option<Arc<ColumnLayout>>>);

impl Clone for LayoutCache {
    fn clone(&self) -> LayoutCache {
        LayoutCache::default()
    }
}

impl Mechanism {
    /// The plan of some columns, with one set of rows or two.
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
